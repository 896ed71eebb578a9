"""The share of a work that is told: it only grows, and the plan may change on the way."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from motdiff.progress import Progress


def test_parts_move_the_share_by_their_cost():
    told = []
    progress = Progress(told.append)
    progress.expect(4)
    for cost in (1, 2, 0.5):
        progress.spend(cost)
    progress.finish()
    assert told == pytest.approx([0.25, 0.75, 0.875, 1])


@pytest.mark.parametrize("change", [lambda p: p.expect(6), lambda p: p.expect_more(4)])
def test_more_work_than_planned_slows_the_share_and_never_turns_it_back(change):
    told = []
    progress = Progress(told.append)
    progress.expect(4)
    progress.spend(2)
    change(progress)
    for _ in range(6):
        progress.spend(1)
    assert told == pytest.approx([0.5, *(0.5 + k / 12 for k in range(1, 6)), 0.999])


def test_less_work_than_planned_speeds_it_up():
    told = []
    progress = Progress(told.append)
    progress.expect(4)
    progress.spend(1)
    progress.expect_more(-2)
    progress.spend(0.5)
    assert told == pytest.approx([0.25, 0.625])


def test_only_the_end_is_the_whole():
    told = []
    progress = Progress(told.append)
    progress.spend(3)  # nothing was planned
    progress.finish()
    assert told == [0.999, 1]


def test_pieces_side_by_side_tell_in_order():
    told = []
    progress = Progress(told.append)
    progress.expect(9)

    def work(piece):
        for step in range(1, 51):
            piece(step / 50)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, [progress.piece(1.0) for _ in range(8)]))
    assert told == sorted(told)
    assert len(told) == 400
    assert told[-1] == pytest.approx(8 / 9)
