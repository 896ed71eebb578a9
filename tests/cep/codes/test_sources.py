"""Codes by their bits, files and names."""

import pytest

from cep.codes.sources import code_file, code_label, find_code, load_codes
from cep.files.code_files import StoredCode, write_code
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode


def test_what_says_nothing_of_time_lasts_as_long_as_the_codes_that_do(tmp_path):
    file = tmp_path / "code.json"
    write_code(file, StoredCode(ShutterCode("11100101", 250_000)))
    codes = load_codes(["open", "10110111", "bdinr-8", str(file)])
    assert [code.chip_ns for code in codes] == [250_000] * 4
    assert [code.bits for code in codes] == ["11111111", "10110111", "11100101", "11100101"]


def test_a_complement_is_for_the_shutter_of_its_file(tmp_path):
    about = {"device": "flc", "camera": Camera().to_dict(), "seed": 3}
    write_code(tmp_path / "code.json", StoredCode(ShutterCode("1101", 5000), problem=about))
    stored = find_code(f"complement:{tmp_path / 'code.json'}")
    assert stored.code == ShutterCode("0010", 5000)
    assert stored.problem == {"device": "flc", "camera": about["camera"]}
    assert not stored.metrics


def test_a_file_is_named_by_its_suffix_or_is_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("shutter", "1011", "code.json"):
        write_code(name, StoredCode(ShutterCode("1101", 5000)))
    assert find_code("shutter").code == ShutterCode("1101", 5000)
    assert find_code("complement:shutter").code == ShutterCode("0010", 5000)
    assert code_file("code.json").name == "code.json"
    # bits stay bits, whatever lies in the folder
    assert code_file("1011") is None
    assert find_code("1011").code.bits == "1011"
    assert code_file("raskar-52") is None
    # the file that is missing is named, no list of codes
    with pytest.raises(FileNotFoundError, match=r"cod\.json"):
        find_code("cod.json")


@pytest.mark.parametrize(
    ("source", "label"),
    [
        ("raskar-52", "raskar-52"),
        ("1011" * 4, "1011" * 4),
        ("1011" * 5, "101110111011... (20)"),
        ("folder/code 2.json", "code 2"),
        ("complement:folder/code 2.json", "complement:code 2"),
        ("complement:" + "1011" * 5, "complement:101110111011... (20)"),
    ],
)
def test_a_label_is_short(source, label):
    assert code_label(source) == label
