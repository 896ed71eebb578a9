"""A new export format touches its own file and one line: every list reads the registry."""

import importlib
import importlib.util
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from cep.commands import export
from cep.commands.help_pages import Command
from cep.studio.views import start_view
from hw.export import EXPORTERS, export_program
from hw.export.base import GENERIC, Exporter
from hw.program import Program

ROOT = Path(__file__).resolve().parents[3]


def documentation():
    spec = importlib.util.spec_from_file_location(
        "export_formats", ROOT / "docs" / "_extensions" / "export_formats.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def morse():
    """A format that is registered while a test runs."""

    class Morse(Exporter):
        name = "morse"
        suffix = ".morse"
        summary = "dots and dashes, for lamps"
        needs = "a lamp"
        manual = "ITU-R M.1677-1"
        tick_ns = 1000

        def export(self, program, _device=GENERIC, /):
            return f"{program.chip_ns} {program.bits}".replace("1", "-").replace("0", ".")

        def parse_back(self, text, /):
            chip_ns, bits = text.replace("-", "1").replace(".", "0").split()
            return Program(bits, int(chip_ns))

    yield Morse
    del EXPORTERS["morse"]


def help_of_export():
    """Print the help of a command line that is made now."""
    app = typer.Typer()
    app.command(cls=Command)(importlib.reload(export).export)
    return CliRunner().invoke(app, ["--help"]).output


def test_a_new_format_is_in_every_list(morse):
    assert "morse: dots and dashes" in help_of_export()
    assert start_view()["formats"][-1] == {"name": "morse", "about": morse.summary}
    page = documentation().with_table((ROOT / "docs" / "hardware.md").read_text())
    assert "| `morse` | dots and dashes, for lamps | a lamp | 1000 ns | ITU-R M.1677-1 |" in page
    assert export_program(Program("101", 1000), "morse") == "-... -.-"
    with pytest.raises(ValueError, match=f"{', '.join(EXPORTERS)}, got 'vhs'"):
        export_program(Program("101", 1000), "vhs")


def test_the_page_lists_the_formats_there_are():
    importlib.reload(export)
    page = (ROOT / "docs" / "hardware.md").read_text()
    assert documentation().with_table(page) == page, (
        "run python docs/_extensions/export_formats.py"
    )
    for name in EXPORTERS:
        assert f"{name}: " in help_of_export()


@pytest.mark.parametrize("page", ["README.md", "docs/tour.md"])
def test_the_examples_name_the_formats_there_are(page):
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    [example] = [line for line in lines if line.startswith("cep export code.json --format c ")]
    assert set(EXPORTERS) <= set(example.split()), f"{page}: {example}"
