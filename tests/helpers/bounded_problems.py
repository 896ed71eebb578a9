"""Small problems whose codes are all counted, and the best figures of all their codes."""

from itertools import combinations

import numpy as np

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis
from cep.proofs.certify.minimum import min_chip
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory

BOTH_GOALS = (("min-mtf", 1.0), ("noise", 1.0))


def arc(length_px=6.0, samples=16):
    angle = np.linspace(0, 2.2, samples) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


def accelerated(length_px=9.0, samples=12):
    x = length_px * np.linspace(0, 1, samples) ** 2
    return Trajectory.from_samples(np.stack([x, 0.5 * x], 1))


def all_codes(chips, counts):
    chosen = [pick for k in counts for pick in combinations(range(chips), k)]
    codes = np.zeros((len(chosen), chips))
    for row, pick in zip(codes, chosen, strict=True):
        row[list(pick)] = 1
    return codes


def best_of_all(problem):
    """Largest smallest |H| on the continuum and least noise over all codes, worst scenario and
    direction."""
    low, high = problem.open_limits
    codes = all_codes(problem.chips, range(low, high + 1))
    paths = [scenario.trajectory for scenario in problem.scenarios]
    paths += [path.reversed() for path in paths if problem.both_directions(path)]
    lowest = np.full(len(codes), np.inf)
    noise = np.full(len(codes), -np.inf)
    for path in paths or [None]:
        if path is None:
            size = 512 * problem.chips
            power = np.abs(np.fft.rfft(codes, size)) ** 2 / problem.chips**2
            weight = np.full(size // 2 + 1, 2 / size)
            weight[[0, -1]] /= 2
        else:
            samples = band_samples(path)
            weight = samples.weight
            power = np.abs(codes @ chip_basis(path, problem.chips, samples.fx, samples.fy)) ** 2
        lowest = np.minimum(lowest, np.sqrt(power.min(axis=1)))
        noise = np.maximum(noise, 10 * np.log10(1 / np.maximum(power, 1e-30) @ weight))
    best = 0.0
    for index in np.argsort(-lowest):
        if lowest[index] <= best:
            break
        # the continuum only lowers what the samples say
        code = ShutterCode(codes[index])
        exact = (
            problem.measure(code, budget=0).min_mtf if paths else min_chip(code) / problem.chips
        )
        best = max(best, exact)
    return best, noise.min()


PROBLEMS = {
    "circle": SearchProblem(chips=10, open_range=(5, 5), objective=BOTH_GOALS),
    "circle dark": SearchProblem(chips=11, open_range=(3, 3), objective=BOTH_GOALS),
    "circle free": SearchProblem(chips=9, objective=BOTH_GOALS),
    "straight": SearchProblem.along(
        Trajectory.straight(9.0), chips=8, open_range=(3, 5), objective=BOTH_GOALS
    ),
    "straight, short": SearchProblem.along(
        Trajectory.straight(2.0), chips=8, open_range=(4, 4), objective=BOTH_GOALS
    ),
    "straight, long": SearchProblem.along(
        Trajectory.straight(11.0, angle_rad=0.6), chips=8, open_range=(5, 5), objective=BOTH_GOALS
    ),
    "accelerated, known": SearchProblem.along(
        accelerated(), chips=8, open_range=(4, 4), direction="forward", objective=BOTH_GOALS
    ),
    "accelerated, unknown": SearchProblem.along(
        accelerated(), chips=8, objective=BOTH_GOALS, direction="unknown"
    ),
    "curved, known": SearchProblem.along(
        arc(), chips=8, open_range=(4, 4), direction="forward", objective=BOTH_GOALS
    ),
    "curved, unknown": SearchProblem.along(
        arc(), chips=6, objective=BOTH_GOALS, direction="unknown"
    ),
    "two motions": SearchProblem(
        chips=7,
        open_range=(3, 5),
        scenarios=(Scenario(accelerated(6.0)), Scenario(Trajectory.straight(4.0))),
        objective=BOTH_GOALS,
    ),
}
