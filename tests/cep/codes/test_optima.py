"""The bundled optima are those of the table in the documentation."""

import re
from pathlib import Path

import pytest

from cep.codes.optima import OPTIMA
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum

TABLE = Path(__file__).parents[3] / "docs" / "optima.md"


def rows():
    """Return minimum, open chips, length and bits of each row with any number of open chips."""
    pattern = r"^\| \d+ \| (\d\.\d{6}) \| (\d+) \| (\d+) \| `([01]+)` \|"
    return [
        (float(minimum), int(opened), int(length), bits)
        for minimum, opened, length, bits in re.findall(pattern, TABLE.read_text(), re.MULTILINE)
    ]


def test_the_table_has_the_bundled_codes_and_no_others():
    assert list(dict.fromkeys(bits for *_, bits in rows())) == list(OPTIMA)


def test_each_row_states_what_its_code_has():
    for minimum, opened, length, bits in {row[-1]: row for row in rows()}.values():
        assert (bits.count("1"), len(bits)) == (opened, length)
        assert chip_minimum(ShutterCode(bits)).lower == pytest.approx(minimum, rel=2e-6)
