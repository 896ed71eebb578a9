"""Code files and strict JSON: what is written is read back, what is wrong is named."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.files.code_files import StoredCode, read_code, write_code
from cep.optics.code import ShutterCode
from motdiff.files.json_files import json_text, plain


@given(
    st.text("01", min_size=1, max_size=80).filter(lambda bits: "1" in bits), st.integers(1, 10**12)
)
def test_a_code_survives_its_file(tmp_path_factory, bits, chip_ns):
    path = tmp_path_factory.mktemp("code") / "code.json"
    stored = StoredCode(ShutterCode(bits, chip_ns), {"min_mtf": 0.1}, {"seed": 3}, {"lower": 0.09})
    write_code(path, stored)
    assert read_code(path) == stored
    assert json.loads(path.read_text())["schema"] == "cep.code/1"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "cep.code/2"}, r'wanted schema "cep.code/1", found .cep.code/2.'),
        ({"schema": None}, "wanted schema"),
        ({"bits": "10x1"}, "only 0 and 1"),
        ({"bits": "0000"}, "all chips are closed"),
        ({"bits": ""}, "empty"),
        ({"bits": [1, 0]}, "must be a string"),
        ({"bits": ...}, '"bits" is missing'),
        ({"chip_ns": 0}, "chip_ns"),
        ({"chip_ns": 1.5}, "chip_ns"),
        ({"chip_ns": 10**400}, "chip_ns"),
        ({"chip_ns": True}, "chip_ns"),
        ({"chip_ns": ...}, '"chip_ns" is missing'),
        ({"metrics": [1]}, "metrics: must be an object or null"),
    ],
)
def test_a_wrong_code_file_is_refused_in_one_line(tmp_path, change, message):
    document = {"schema": "cep.code/1", "bits": "1011", "chip_ns": 1000, **change}
    path = tmp_path / "code.json"
    path.write_text(
        json.dumps({key: value for key, value in document.items() if value is not ...})
    )
    with pytest.raises(ValueError, match=message) as caught:
        read_code(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_as_windows_editors_write_is_no_harm(tmp_path):
    path = tmp_path / "code.json"
    path.write_text(
        json.dumps({"schema": "cep.code/1", "bits": "1011", "chip_ns": 1000}), encoding="utf-8-sig"
    )
    assert read_code(path).code == ShutterCode("1011", 1000)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '"cep.code/1"', "\0"])
def test_what_is_not_a_json_object_is_refused(tmp_path, text):
    (tmp_path / "code.json").write_text(text)
    with pytest.raises(ValueError, match=r"not a JSON file|wanted schema"):
        read_code(tmp_path / "code.json")


def test_json_is_strict():
    value = {
        "a": float("nan"),
        "b": [np.inf, -np.inf, 1.5],
        "c": np.arange(3),
        "d": np.float32(0.5),
        1: (True, None),
    }
    assert json.loads(json_text(value)) == {
        "a": None,
        "b": [None, None, 1.5],
        "c": [0, 1, 2],
        "d": 0.5,
        "1": [True, None],
    }
    assert plain(StoredCode(ShutterCode("1"))) == {
        "code": {"bits": "1", "chip_ns": 1_000_000},
        "metrics": {},
        "problem": {},
        "certificate": {},
    }
