"""Every study says what it measures: `python -m lab.studies.NAME --help`."""

import importlib
from pathlib import Path

import pytest

import lab.studies

SHARED = {"__init__", "inputs", "motions"}
STUDIES = sorted({file.stem for file in Path(lab.studies.__path__[0]).glob("*.py")} - SHARED)


@pytest.mark.parametrize("name", [*STUDIES, "goldens.__main__"])
def test_help_describes_the_study(name, monkeypatch, capsys):
    module = importlib.import_module(f"lab.studies.{name}")
    monkeypatch.setattr("sys.argv", [name, "--help"])
    with pytest.raises(SystemExit) as exit_status:
        module.main()
    assert exit_status.value.code == 0
    printed = capsys.readouterr().out
    assert module.__doc__.strip() in printed
    assert f"python -m lab.studies.{name.removesuffix('.__main__')}" in printed
