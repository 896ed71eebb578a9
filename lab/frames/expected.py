"""Expected PSNR of the restoration from several frames of one motion, one through each code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_sum
from cep.optics.scene import wiener_mse
from cep.search.expected import directed_scenarios, motion_rows, motion_samples, worst_psnr_db
from cep.search.problem import Scenario, SearchProblem
from motdiff.types import FloatArray


def joint_psnr_db(
    problem: SearchProblem, codes: Sequence[ShutterCode], *, noise: ArrayLike
) -> FloatArray:
    """PSNR, dB, of the best linear restoration from several frames, one through each code, (L,).

    The least mean square error is the mean over the band of ``1 / (1 / S + sum over frames of
    |H|^2 / N)``. M frames through the same code are as good as one with an Mth of the noise.

    Parameters
    ----------
    problem : SearchProblem
        As of :class:`cep.search.expected.ExpectedPsnr`.
    codes : sequence of ShutterCode
        Of each frame.
    noise : (L, R) array_like
        Variance through each code, for L cases.
    """
    chips = np.array([code.array for code in codes])
    variances = np.atleast_2d(np.asarray(noise, dtype=np.float64))

    def error(scenario: Scenario) -> FloatArray:
        samples = motion_samples(scenario.trajectory, exact=True)
        power = np.abs(coded_sum(motion_rows(problem, scenario, samples), chips)) ** 2
        # frames add up as |H|^2 / N: noise of 1 is left
        powers = [(power / variance[:, None]).sum(axis=0) for variance in variances]
        return np.array([wiener_mse(total, samples, 1.0, scene=problem.scene) for total in powers])

    errors = [
        [error(directed) for directed in directed_scenarios(problem, scenario)]
        for scenario in problem.scenarios
    ]
    return worst_psnr_db(problem, errors)
