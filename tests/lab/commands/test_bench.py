"""``python -m lab bench`` without a table's name: all of them in one folder, with a page that
leads to them."""

import re
from pathlib import Path

import pytest

from cep.commands.console import FAILURE, INTERRUPTED
from lab.bench import all_jobs
from lab.bench.all_jobs import INDEX
from lab.bench.harness import Request
from lab.bench.published_codes import codes_job
from lab.jobs.engine import Engine

NAMES = {"first": "bdinr-8", "second": "barker-13"}
ALL = ("bench", "--quick", "--workers", "1", "-o", "out")


def untouchable(*_arguments, **_options):
    pytest.fail("a finished cell was made again")


@pytest.fixture
def tables(workplace, monkeypatch):
    """Two small tables in the place of the seven."""

    def few(request, *, gyro, search_s):
        return {
            name: codes_job(
                Request(request.output / name, request.engine, force=request.force),
                names=[code],
                time_s=0.1,
                seed=0,
            )
            for name, code in NAMES.items()
        }

    monkeypatch.setattr(all_jobs, "_jobs", few)


def failing(monkeypatch, error):
    """Let the search against the second code fail; returns what mends it."""
    from lab.bench import published_codes as codes

    real = codes.anneal

    def anneal(problem, **options):
        if problem.chips == 13:
            raise error
        return real(problem, **options)

    monkeypatch.setattr(codes, "anneal", anneal)
    return lambda: monkeypatch.setattr(codes, "anneal", real)


def test_all_tables_in_one_folder_and_found_again(lab, tables, workplace, monkeypatch):
    found = lab.succeeds(*ALL)
    assert list(found["tables"]) == list(NAMES)
    assert (found["failures"], found["missing"], found["unmade"]) == ({}, {}, [])
    assert all(Path(file).is_file() for file in found["files"])
    text = Path("out", INDEX).read_text()
    assert "`python -m lab bench --quick`" in text
    assert "`python -m lab bench codes barker-13 --time 0.1`" in text
    assert "numpy" in text
    links = re.findall(r"\]\((.*?)\)", text)
    assert len(links) == 8
    assert all(Path("out", link).is_file() for link in links)
    assert str(workplace) not in text

    assert "exists already" in lab.refuses(*ALL)
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    assert lab.succeeds(*ALL, "--force")["tables"] == found["tables"]


def test_people_see_the_tables(lab, tables):
    lab(*ALL)
    assert lab.code == 0, lab.err
    assert lab.out.count("better on both: ") == 2
    assert f"out: {INDEX}, first, second" in lab.out


def test_a_failed_cell_is_named_and_the_exit_code_tells(lab, tables, monkeypatch):
    mend = failing(monkeypatch, ValueError("code: too short"))
    lab(*ALL, "--json")
    assert lab.code == FAILURE
    assert lab.err == f"lab: 1 cells failed: out/{INDEX} names them\n"
    assert lab.json["failures"] == {"second": {"barker-13": "code: too short"}}
    assert len(lab.json["tables"]["first"]["codes"]) == 1
    assert "- failed: barker-13: code: too short" in Path("out", INDEX).read_text()
    mend()
    assert lab.succeeds(*ALL, "--force")["failures"] == {}


def test_stopped_it_writes_what_is_there_and_goes_on_later(lab, tables, monkeypatch):
    monkeypatch.setitem(NAMES, "first", "barker-13")
    monkeypatch.setitem(NAMES, "second", "bdinr-8")
    mend = failing(monkeypatch, KeyboardInterrupt())
    lab(*ALL, "--json")
    assert (lab.code, lab.err) == (INTERRUPTED, "lab: interrupted\n")
    assert (lab.json["missing"], lab.json["unmade"]) == ({"first": 1}, ["second"])
    text = Path("out", INDEX).read_text()
    assert "stopped early" in text
    assert "second is not measured" in text
    assert not Path("out/second").exists()
    mend()
    whole = lab.succeeds(*ALL, "--force")
    assert (whole["missing"], whole["unmade"]) == ({}, [])


def test_a_cost_is_never_measured_on_a_cluster(monkeypatch):
    """Beside others, or on machines of several kinds, times could not be compared."""
    engines = {}
    for name in ("speed_job", "blind_job", "cep_job", "codes_job"):
        monkeypatch.setattr(
            all_jobs,
            name,
            lambda request, **_options: engines.update({request.output.name: request.engine}),
        )
    given = Engine(Path("cells"), 2, "tcp://127.0.0.1:9")
    all_jobs.all_jobs(Request(Path("out"), given, quick=True), gyro=None, search_s=30.0)
    assert engines.pop("speed") == Engine(Path("cells"), 1, None)
    assert engines == dict.fromkeys(
        ["codes", "blind-paper", "blind-ours", "cep-paper", "cep-ours"], given
    )


def test_help_tells_how_a_stopped_run_goes_on(lab):
    for command in (
        ("bench",),
        ("bench", "blind"),
        ("bench", "cep"),
        ("bench", "codes"),
    ):
        assert "the same command with --force goes on" in " ".join(
            lab(*command, "--help").out.split()
        )


def test_options_alone_run_and_no_arguments_help(lab, tables):
    assert "Usage: python -m lab bench" in lab("bench").out
    assert lab.code == 2
    for option in (("--quick",), ("-o", "out"), ("--workers", "2")):
        line = lab.refuses("bench", *option, "codes", "bdinr-8")
        assert re.fullmatch(
            r"lab: (-\S+): belongs after the table's name: python -m lab bench codes \1\n", line
        )
    assert not Path("out").exists()


def test_what_exists_is_refused_before_any_work(lab, tables, monkeypatch):
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    Path("out/second").mkdir(parents=True)
    Path("out/second/codes.csv").write_text("mine")
    assert "codes.csv: exists already" in lab.refuses(*ALL)
    assert Path("out/second/codes.csv").read_text() == "mine"


def test_the_tables_are_the_papers():
    engine = Engine(Path("cells"), 2, None)
    jobs = all_jobs.all_jobs(Request(Path("out"), engine, quick=True), gyro=None, search_s=30.0)
    assert list(jobs) == ["codes", "speed", "blind-paper", "blind-ours", "cep-paper", "cep-ours"]
    assert {name: job.about["folder"] for name, job in jobs.items()} == {
        name: Path("out", name) for name in jobs
    }
    assert all_jobs._FILES.keys() == jobs.keys()
    assert {
        name: job.about["protocol"].name for name, job in jobs.items() if name.startswith("blind")
    } == {
        "blind-paper": "paper",
        "blind-ours": "ours",
    }
    assert jobs["cep-ours"].about["protocol"] == "ours"


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda folder: None, "no such folder"),
        (
            lambda folder: folder.mkdir() or (folder / "im05_flit01.mat").write_bytes(b""),
            "im05_flit01.mat",
        ),
        (lambda folder: (folder / "GOPR01" / "blur").mkdir(parents=True), "no folder sharp"),
    ],
)
def test_bad_folders_are_refused_before_any_work(lab, workplace, monkeypatch, made, message):
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    made(Path("data"))
    line = lab.refuses("bench", "--quick", "--data", "data", "-o", "out")
    assert message in line
    assert "data" in line
    assert not Path("out").exists()
