"""What stands under docs/results can be made again: its protocols are read by the commands that it
names."""

from pathlib import Path

import pytest

from lab.bench.blind.protocol import Protocol
from lab.bench.coded.protocol import coded_protocol

RESULTS = Path(__file__).parents[3] / "docs" / "results"
FILES = sorted(RESULTS.glob("*/*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_its_protocol_is_read(path):
    read = coded_protocol if path.parent.name.startswith("cep-") else Protocol.load
    assert read(str(path)).photos > 0


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_its_report_names_it(path):
    (report,) = path.parent.glob("*.md")
    assert f"--protocol {path.name}" in report.read_text(encoding="utf-8")


def test_there_are_results():
    assert FILES
