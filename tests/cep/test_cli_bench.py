"""``cep bench codes``: the comparison, its files, and its refusals."""

from pathlib import Path

import pytest

from cep.bench.codes import code_rows
from cep.code import ShutterCode


def test_codes_are_compared_at_equal_light(cep, workplace):
    found = cep.succeeds("bench", "codes", "bdinr-8", "barker-13", "--time", "0.3", "-o", "codes.md")
    rows = {row["name"]: row for row in found["tables"]["codes"]}
    assert set(rows) == {"bdinr-8", "barker-13"}
    for row in rows.values():
        assert len(row["bits"]) == row["chips"]
        assert row["bits"].count("1") == row["open"]
    # the largest minimum of eight chips, five of them open, is this code's own: docs/optima.md
    assert rows["bdinr-8"]["min_chip"]["published"] == pytest.approx(0.9128, abs=1e-4)
    assert rows["bdinr-8"]["min_chip"]["ours"] <= 0.9128 + 1e-4
    assert not rows["bdinr-8"]["better"]
    lines = Path("codes.md").read_text().splitlines()
    assert len(lines) == 4
    assert all(line.count(" | ") == 6 for line in lines)


def test_interrupted_it_keeps_the_rows():
    seen = []

    def progress(_fraction, name):
        seen.append(name)
        if name == "second":
            raise KeyboardInterrupt

    codes = [("first", ShutterCode("110100101")), ("second", ShutterCode("1101001011"))]
    rows = code_rows(codes, time_s=0.2, progress=progress)
    assert [row.name for row in rows] == ["first"]


@pytest.mark.parametrize(
    ("options", "message"),
    [(("nothing-7",), "nothing-7"), (("bdinr-8", "--time", "0"), "--time"), (("bdinr-8", "-o", "no/where.md"), "no")],
)
def test_refusals(cep, workplace, options, message):
    assert message in cep.refuses("bench", "codes", *options)
