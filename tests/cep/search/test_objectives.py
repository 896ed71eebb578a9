"""Objectives are registered classes: every list has them, and one more is found in each."""

import subprocess
import sys

import numpy as np
import pytest
from works import works

from cep.search.annealing.cooling import fresh_otf, total_cost
from cep.search.annealing.terms import BLOCK, lay_out
from cep.search.cost import CodeCost
from cep.search.objectives import OBJECTIVES, RECIPROCAL, STEEP, Criterion
from cep.search.optimize import optimize
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

DUMMY = '''
from cep.search.objectives import OBJECTIVES, Criterion

class MeanPower(Criterion):
    """Inverse of the mean power."""

    name = "dummy"
    help = "inverse mean power"
    cites = ("raskar2006",)

    def figure(self, spectrum):
        return 1 / (spectrum.power @ spectrum.weight).astype(float)

    def terms(self, columns):
        flat = columns.weight[None] * 0.0
        return flat + columns.chips**-2, flat + 1.0

OBJECTIVES["dummy"] = MeanPower()
'''


@pytest.fixture
def dummy():
    """Register another objective, for this test."""
    space = {}
    exec(DUMMY, space)
    yield space["MeanPower"]
    del OBJECTIVES["dummy"]


def test_the_page_has_a_row_of_each(pytestconfig):
    text = (pytestconfig.rootpath / "docs" / "theory" / "search.md").read_text(encoding="utf-8")
    assert {name for name in OBJECTIVES if f"| `{name}`" not in text} == set()


def test_each_says_what_it_is():
    for name, criterion in OBJECTIVES.items():
        assert isinstance(criterion, Criterion)
        assert (criterion.name, criterion.unit) == (name, "dB")
        assert criterion.help
        assert set(criterion.cites) <= works().keys()
        assert criterion.hot_db > 0


def rank_correlation(name):
    """Of the compiled loops' costs of random codes with those by the objective's figure."""
    # curved: along a straight path random codes have true zeros
    time = np.linspace(0, 1, 24) ** 1.4
    path = Trajectory.from_samples(np.stack([9 * time, 4 * np.sin(3 * time)], axis=1))
    problem = SearchProblem.along(path, chips=16, objective=name, open_range=(3, 13))
    judge = CodeCost(problem, oversampling=8)
    tables = lay_out(judge)
    codes = problem.random_codes(64, rng=np.random.default_rng(0)).astype(np.int8)
    otf = np.empty((1, tables.rows.shape[2], 2, BLOCK), np.float32)
    loop_costs = []
    for code in codes:
        fresh_otf(tables, code, problem.chips, otf)
        loop_costs.append(total_cost(tables, problem.chips, code, otf))
    ranks = [np.argsort(np.argsort(costs)) for costs in (loop_costs, judge.cost_of(codes))]
    return np.corrcoef(ranks)[0, 1]


@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_compiled_loops_rank_codes_as_the_figure_does(name):
    assert rank_correlation(name) > 0.99, (
        f"objective {name}: the search's compiled loops rank codes otherwise than its figure does;"
        " its kind (RECIPROCAL, STEEP or FLATNESS), terms and light must belong to that figure, or"
        " cep/search/annealing/terms.py needs another kind"
    )


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("noise", {"kind": STEEP}),
        ("min-mtf", {"kind": RECIPROCAL}),
        ("flatness", {"kind": RECIPROCAL}),
        ("flatness", {"light": Criterion.light}),
        ("mse", {"light": Criterion.light}),
        ("mse", {"figure": type(OBJECTIVES["noise"]).figure}),
    ],
)
def test_an_objective_whose_terms_are_not_of_its_figure_is_noticed(monkeypatch, name, mistake):
    wrong = type("Wrong", (type(OBJECTIVES[name]),), mistake)
    monkeypatch.setitem(OBJECTIVES, "wrong", wrong())
    assert rank_correlation("wrong") < 0.99


def test_another_one_is_searched(dummy):
    assert rank_correlation("dummy") > 0.99
    path = Trajectory.straight(8.0)
    problem = SearchProblem.along(path, chips=8, objective="dummy", open_range=(3, 5))
    best = optimize(problem, steps=500)
    judge = CodeCost(problem, oversampling=16, dtype=np.float64)
    codes = problem.random_codes(50, rng=np.random.default_rng(0))
    assert judge.cost_of(best.code.array[None])[0] <= judge.cost_of(codes).min() + 1e-9
    assert best.code.open_chips == 5  # more light, more power
    mixed = SearchProblem.along(path, chips=8, objective=(("dummy", 1.0), ("mse", 0.5)))
    assert len(lay_out(CodeCost(mixed, oversampling=8)).kinds) == 2


def test_another_one_is_in_every_list(tmp_path):
    """The help of the commands, the refusal of a wrong name, the benchmark, the page of works."""
    script = (
        DUMMY
        + """
import sys
sys.path.insert(0, "docs/_extensions")
from cep.commands.main import main
from lab.commands.main import main as lab_main

main(["optimize", "--help"])
lab_main(["design-class", "--help"])
main(["optimize", "--linear", "9", "--chips", "9", "--objective", "wrong"])

from lab.bench.coded import protocol
import citations

assert "dummy" in protocol._ALLOWED["objective"]
print(list(citations.cite(["dummy"]).works))
"""
    )
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    shown = " ".join(run.stdout.replace("│", " ").split())
    assert shown.count("dummy (inverse mean power)") == 2
    assert f"must be one of {', '.join(OBJECTIVES)}, dummy, got 'wrong'" in run.stderr
    assert "raskar2006" in run.stdout.splitlines()[-1]
