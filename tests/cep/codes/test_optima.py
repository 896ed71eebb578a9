"""The bundled optima are those of the tables in the documentation, which name proofs that are
there."""

import re
from pathlib import Path

import pytest

from cep.codes.optima import OPTIMA
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum

ROOT = Path(__file__).parents[3]
TABLE = (ROOT / "docs" / "optima.md").read_text()
ROW = r"^\| (\d+) \| (\d\.\d{6}) \| (\d+) \| (\d+) \| `([01]+)` \|"
SINGLE = r"^\| (52) \| (26) \| (\d\.\d{6}) \| (\d+) \| `([01]+)` \|"


def rows():
    """Return most chips, minimum, open chips, length and bits of each row with any number of open
    chips."""
    found = re.findall(ROW, TABLE, re.MULTILINE)
    return [
        (int(n), float(least), int(opened), int(length), bits)
        for n, least, opened, length, bits in found
    ]


def by_open_chips():
    """Return the last row of the table by open chips, as open chips -> minimum, and open chips ->
    bits."""
    chips, *cells = re.findall(r"^\| (\d+) \| (\d\.\d{4}) \|(.*)\|$", TABLE, re.MULTILINE)[-1]
    minima = [float(cell) for cell in " | ".join(cells).split(" | ")]
    codes = re.findall(r"^\| (\d+) \| `([01]+)` \|$", TABLE, re.MULTILINE)
    return int(chips), dict(enumerate(minima, 3)), {int(opened): bits for opened, bits in codes}


def test_the_table_has_the_bundled_codes_and_no_others():
    single = [bits for *_, bits in re.findall(SINGLE, TABLE, re.MULTILINE)]
    listed = [*dict.fromkeys(bits for *_, bits in rows()), *by_open_chips()[2].values(), *single]
    assert listed == [entry.bits for entry in OPTIMA]


def test_each_code_is_proven_for_the_chips_of_its_last_row():
    last = {bits: chips for chips, *_, bits in rows()}
    free = [entry for entry in OPTIMA if entry.fewest_open < entry.most_open]
    assert last == {entry.bits: entry.chips for entry in free}
    assert all((entry.fewest_open, entry.most_open) == (1, entry.chips) for entry in free)
    chips, _, codes = by_open_chips()
    fixed = {entry.bits: (entry.chips, entry.most_open) for entry in OPTIMA if entry not in free}
    assert fixed == {bits: (chips, opened) for opened, bits in codes.items()} | {
        OPTIMA[-1].bits: (52, 26)
    }


@pytest.mark.parametrize(
    "entry", OPTIMA, ids=lambda entry: f"{entry.chips}-{entry.bits.count('1')}"
)
def test_its_proof_is_a_page_or_a_file_of_the_documentation(entry):
    text = (ROOT / entry.proof).read_text()
    assert entry.bits in text


def test_each_row_states_what_its_code_has():
    for _, minimum, opened, length, bits in {row[-1]: row for row in rows()}.values():
        assert (bits.count("1"), len(bits)) == (opened, length)
        assert chip_minimum(ShutterCode(bits)).lower == pytest.approx(minimum, rel=2e-6)
    ((_, opened, minimum, length, bits),) = re.findall(SINGLE, TABLE, re.MULTILINE)
    assert (bits.count("1"), len(bits)) == (int(opened), int(length))
    assert chip_minimum(ShutterCode(bits)).lower == pytest.approx(float(minimum), rel=2e-6)


def test_the_codes_by_open_chips_have_the_minima_of_the_last_row():
    _, minima, codes = by_open_chips()
    assert minima.keys() == codes.keys()
    for opened, bits in codes.items():
        assert bits.count("1") == opened
        assert chip_minimum(ShutterCode(bits)).upper == pytest.approx(minima[opened], abs=6e-5)
