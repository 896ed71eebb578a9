"""Figures of two cameras whose photos are restored together, and the comparison of such pairs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.measure import PairMetrics
from cep.search.baselines import BaselineRow, Comparison
from cep.search.cost import CodeCost
from cep.search.expected import joint_psnr_db, light_noise
from cep.search.problem import SearchProblem
from cep.search.search_result import Baseline

_ZERO_POWER = 1e-24  # smaller is rounding


def measure_pairs(
    problem: SearchProblem, pairs: Iterable[tuple[ShutterCode, ShutterCode]]
) -> list[PairMetrics]:
    """Measure pairs of codes, which two cameras play at the same time along a problem's motions.

    Parameters
    ----------
    problem : SearchProblem
    pairs : iterable of (ShutterCode, ShutterCode)
    """
    fine = CodeCost.fine(problem.of_one_camera)

    def measured(pair: tuple[ShutterCode, ShutterCode]) -> PairMetrics:
        power = (fine.otf(np.array([code.array for code in pair])) ** 2).sum(axis=(0, 1))
        power = np.where(power < _ZERO_POWER, 0.0, power)
        with np.errstate(divide="ignore"):
            inverse = 1 / power
        noise = max(
            float(motion.samples.weight @ inverse[motion.columns]) for motion in fine.parts
        )
        played = [ShutterCode(code.bits, problem.chip_ns) for code in pair]
        variances = light_noise(
            problem.camera, played, response=problem.response, scene=problem.scene
        )
        (psnr_db,) = joint_psnr_db(problem, played, noise=variances).tolist()
        return PairMetrics(
            min_mtf=float(np.sqrt(power.min() / 2)),
            noise_gain_db=float(10 * np.log10(noise)),
            mse_db=-psnr_db,
        )

    return [measured(pair) for pair in pairs]


def compare_pairs(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    baselines: Iterable[Baseline],
    snapshot: ShutterCode | None = None,
) -> Comparison:
    """Measure a code and its complement, and what two cameras would play instead.

    Parameters
    ----------
    problem : SearchProblem
        Of two frames.
    code : ShutterCode
    baselines : iterable of Baseline
        As the code's search returned them, each beside its complement.
    snapshot : ShutterCode, optional
        Best single exposure that both cameras take.

    Returns
    -------
    Comparison
        The code first, then two cameras exposed alike, then the baselines; ``code`` of each row is
        that of the first camera.
    """
    single = problem.of_one_camera
    open_shutter = ShutterCode("1" * problem.chips)
    alike = [("two open shutters", open_shutter)]
    if snapshot is not None:
        alike.append(("two best single exposures", snapshot))
    rows = [
        ("this code and complement", code, code.complement(), problem.allows(code), False),
        *((name, played, played, single.allows(played), False) for name, played in alike),
        *(
            (row.name, row.code, row.code.complement(), row.within_limits, row.stopped_early)
            for row in baselines
        ),
    ]
    metrics = measure_pairs(problem, [(first, second) for _, first, second, *_ in rows])
    return Comparison(
        BaselineRow(name, ShutterCode(first.bits, code.chip_ns), within, early, metrics=figures)
        for (name, first, _, within, early), figures in zip(rows, metrics, strict=True)
    )
