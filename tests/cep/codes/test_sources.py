"""Codes by their bits, files and names."""

from cep.codes.sources import find_code, load_codes
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
