"""Codes by their bits, files and names."""

from cep.codes.sources import load_codes
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode


def test_what_says_nothing_of_time_lasts_as_long_as_the_codes_that_do(tmp_path):
    file = tmp_path / "code.json"
    write_code(file, StoredCode(ShutterCode("11100101", 250_000)))
    codes = load_codes(["open", "10110111", "bdinr-8", str(file)])
    assert [code.chip_ns for code in codes] == [250_000] * 4
    assert [code.bits for code in codes] == ["11111111", "10110111", "11100101", "11100101"]
