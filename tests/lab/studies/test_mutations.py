"""Mutations are different, leave modules as they were, and are judged as far as time allows."""

import ast

import numpy as np
import pytest

from lab.studies import mutations
from lab.studies.mutations import (
    EXCHANGED,
    SuiteRun,
    UnfinishedError,
    Workplace,
    drawn,
    judged,
    mutations_of,
    names_of_tests,
    tally,
)

SOURCE = '''"""Sums — of numbers."""


def total(n: int | None = None) -> int:
    """
    >>> total(3)
    3
    """
    result = 0
    while n is not None and n > 0:
        result = result + (n >= 0)
        n = n - 1
    return result if result not in (-1,) else f"{n + 1}"
'''
TEST = "from cep.room.sums import total\n\n\ndef test_total():\n    assert total(3) == 3\n"


@pytest.fixture
def root(tmp_path):
    """A product of one room with operators and one without, and a test."""
    for folder in ("cep/room", "cep/bare", "motdiff", "hw", "tests/cep/room"):
        (tmp_path / folder).mkdir(parents=True)
    for package in ("cep", "cep/room"):
        (tmp_path / package / "__init__.py").touch()
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['slow']\n")
    (tmp_path / "cep/room/sums.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "cep/bare/names.py").write_text("NAME = 'a - b'\n")
    (tmp_path / "hw/errors.py").write_text("LIMIT = 3 * 4\n")
    (tmp_path / "tests/cep/room/test_sums.py").write_text(TEST)
    return tmp_path


def mutation_of(root, before):
    path = root / "cep/room/sums.py"
    choices = mutations_of(path.relative_to(root), path.read_text(encoding="utf-8"))
    return next(mutation for mutation in choices if mutation.before == before)


# -- what is mutated --------------------------------------------------------------------------


def test_every_operator_but_those_of_formatted_strings_is_mutated(root):
    data = SOURCE.encode()
    operators = []
    for mutation in mutations_of(root / "sums.py", SOURCE):
        operator = " ".join(data[mutation.start : mutation.stop].decode().split())
        assert operator == mutation.before
        assert mutation.after == EXCHANGED[operator]
        assert mutation.line == data[: mutation.start].count(b"\n") + 1
        changed = data[: mutation.start] + mutation.after.encode() + data[mutation.stop :]
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(data))
        operators.append(operator)
    assert sorted(operators) == ["+", "-", ">", ">=", "and", "is not", "not in"]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [0, 1, 4, 8, 50])
def test_no_mutation_is_drawn_twice(root, count, seed):
    choices = drawn(root, count, np.random.default_rng(seed))
    assert len(choices) == min(count, 8)  # of both rooms
    assert len(set(choices)) == len(choices)
    rooms = {choice.module.parts[:2] for choice in choices[:2]}
    assert len(rooms) == min(count, 2)  # in turn


def test_mutations_of_nothing_are_none(tmp_path):
    assert drawn(tmp_path, 3, np.random.default_rng(0)) == []


def test_a_module_is_tested_by_its_mirror_and_its_doctests(root):
    sums = mutation_of(root, "+").module
    assert names_of_tests(root, sums) == ["tests/cep/room/test_sums.py", "cep/room/sums.py"]
    (root / "tests/cep/room/test_sums.py").unlink()
    assert names_of_tests(root, sums) == ["tests/cep/room", "cep/room/sums.py"]


# -- runs of tests ----------------------------------------------------------------------------


def test_a_mutation_fails_tests_and_is_taken_out_again(root):
    workplace = Workplace(root)
    mutation = mutation_of(root, "+")
    run = workplace.run([mutation], ["tests/cep/room/test_sums.py"], limit_s=60)
    assert run.failed == ("tests/cep/room/test_sums.py::test_total",)
    assert (root / mutation.module).read_text(encoding="utf-8") == SOURCE


def test_several_mutations_of_a_module_are_put_in_together(root):
    every_mutation = list(mutations_of(mutation_of(root, "+").module, SOURCE))
    with Workplace(root)._mutated(every_mutation):
        changed = (root / "cep/room/sums.py").read_text(encoding="utf-8")
    assert "while n is None or n < 0:" in changed
    assert "result = result - (n < 0)" in changed
    assert (root / "cep/room/sums.py").read_text(encoding="utf-8") == SOURCE


def test_tests_that_take_too_long_are_ended(root):
    run = Workplace(root).run([mutation_of(root, "-")], ["tests"], limit_s=0.05)
    assert run.failed == ("timeout",)
    assert not run.finished
    assert (root / "cep/room/sums.py").read_text(encoding="utf-8") == SOURCE


def test_a_mutation_gets_a_multiple_of_the_time_without_it():
    assert SuiteRun((), 1.0).limit_s == mutations._LEAST_S
    assert SuiteRun((), 100.0).limit_s == 500.0


# -- verdicts ---------------------------------------------------------------------------------


class MadeUpRuns(Workplace):
    """Tests that fail as given, by the operators exchanged and whether all tests are run."""

    def __init__(self, root, outcomes):
        super().__init__(root)
        self._outcomes = outcomes

    def run(self, mutations, tests, **_options):
        key = ("".join(sorted(m.before for m in mutations)), bool(tests))
        outcome = self._outcomes.get(key, ())
        if outcome is KeyboardInterrupt:
            raise KeyboardInterrupt
        return SuiteRun(tuple(outcome), 1.0)


def test_what_its_mirror_misses_is_judged_by_the_whole_suite(root):
    plus, minus, more = (mutation_of(root, before) for before in ("+", "-", ">"))
    outcomes = {
        ("+", True): ["mirror"],
        ("->", False): ["elsewhere", "flaky"],
        ("", True): [],
        ("-", True): [],
        (">", True): [],
    }
    runs = MadeUpRuns(root, outcomes)
    verdicts = judged(runs, [plus, minus, more], workers=1)
    assert next(verdicts) == (plus, "mirror")
    outcomes[">", True] = ["elsewhere"]  # once its mirror has been asked
    first_run = runs.run

    def run(mutations, tests, **options):
        if mutations == [more] and "elsewhere" not in tests:
            return SuiteRun((), 1.0)
        return first_run(mutations, tests, **options)

    runs.run = run
    assert list(verdicts) == [(minus, ""), (more, "elsewhere")]


@pytest.mark.parametrize("failed", ["interrupted", "tests/cep/room/test_sums.py"])
def test_tests_that_cannot_begin_without_a_mutation_notice_none(root, failed):
    plus = mutation_of(root, "+")
    runs = MadeUpRuns(root, {("", True): [failed], ("+", True): [failed]})
    assert list(judged(runs, [plus], workers=1)) == [(plus, "")]


def test_a_module_of_tests_that_cannot_be_imported_runs_none(root):
    (root / "tests/cep/room/test_sums.py").write_text("import a_module_that_is_not_there\n")
    run = Workplace(root).run([], ["tests"], limit_s=60.0)
    assert run.finished
    assert not run.imported


@pytest.mark.parametrize("end", [KeyboardInterrupt, ["timeout"]])
def test_what_is_known_is_said_where_the_whole_suite_does_not_end(root, monkeypatch, capsys, end):
    chosen = [mutation_of(root, before) for before in ("+", "-", ">")]
    runs = MadeUpRuns(root, {("+", True): ["mirror"], ("->", False): end})

    monkeypatch.setattr(mutations, "cloned", lambda _: pytest.MonkeyPatch.context())
    monkeypatch.setattr(mutations, "drawn", lambda *_: chosen)
    monkeypatch.setattr(mutations, "Workplace", lambda _: runs)
    monkeypatch.setattr("sys.argv", ["mutations"])
    with pytest.raises(SystemExit) as exit_status:
        mutations.main()
    assert exit_status.value.code
    assert capsys.readouterr().out.endswith("\n1 of 3 noticed, 2 not judged\n")


def test_an_unfinished_suite_judges_nothing(root):
    runs = MadeUpRuns(root, {("+", False): ["interrupted"]})
    with pytest.raises(UnfinishedError):
        list(judged(runs, [mutation_of(root, "+")], workers=1))


def test_the_tally_of_all():
    assert tally(2, {"first": "test", "second": ""}) == "1 of 2 noticed"
