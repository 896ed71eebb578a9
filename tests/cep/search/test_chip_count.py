"""Number of chips: the smallest that is as good; the time and Ctrl-C end the choice with what was
tried."""

import pytest

from cep.optics.camera import Camera
from cep.search import exposures
from cep.search.chip_count import choose_chips
from cep.search.expected import WORTH_DB
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

NOISY = Camera(photons_full_scale=10_000, read_noise_e=50)


def along(chips, camera=NOISY):
    return SearchProblem.along(Trajectory.straight(24.0), chips=chips, camera=camera)


def test_the_number_of_chips_is_the_smallest_that_is_as_good():
    made = {}

    def problem_of(count):
        if count > 24:
            raise ValueError("chips: too many")
        made[count] = along(count)
        return made[count]

    choice = choose_chips(problem_of, (6, 12, 24, 48)).uninterrupted()
    assert set(made) == {6, 12, 24}
    assert set(choice.gains_db) == set(made) - {choice.chips}
    assert all(gain <= WORTH_DB for gain in choice.gains_db.values())
    with pytest.raises(ValueError, match="chips: too many"):
        choose_chips(problem_of, (48,))


def test_the_time_ends_the_choice_with_the_first_number():
    found = choose_chips(along, (6, 12, 24), time_s=1e-6)
    assert (found.chips, found.gains_db, found.early) == (6, {}, "time")
    assert along(6).allows(found.code)


def interrupted_at(monkeypatch, number):
    """Ctrl-C in the moves of the ``number``th search, counted from 0."""
    calls = []

    def anneal(problem, **options):
        calls.append(problem.chips)

        def stop(_share, _best):
            raise KeyboardInterrupt

        return real(problem, **options, progress=stop if len(calls) > number else None)

    real = exposures.anneal
    monkeypatch.setattr(exposures, "anneal", anneal)
    return calls


@pytest.mark.parametrize("number", [0, 1])
def test_an_interrupt_keeps_the_best_code_so_far(monkeypatch, number):
    calls = interrupted_at(monkeypatch, number)
    found = choose_chips(along, (6, 12, 24))
    assert calls == [6, 12][: number + 1]
    assert found.early == "interrupted"
    assert found.chips in calls
    assert found.code.chips == found.chips
    assert along(found.chips).allows(found.code)
    with pytest.raises(KeyboardInterrupt):
        choose_chips(along, (6, 12, 24)).uninterrupted()


def test_an_interrupt_before_any_search_leaves_no_code(monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(exposures, "best_snapshot", interrupted)
    found = choose_chips(along, (6, 12))
    assert (found.chips, found.code, found.early) == (6, None, "interrupted")
