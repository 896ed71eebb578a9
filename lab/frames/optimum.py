"""Codes of several exposures of one motion that are restored together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.proofs.measure import HOPELESS_DB, CodeMetrics
from cep.search.baselines import mean_length_px
from cep.search.code_search import (
    SearchOptions,
    described_search,
    ended_early,
    search_code,
    searched_problem,
)
from cep.search.expected import equal_light_noise, joint_psnr_db, light_noise
from cep.search.exposures import (
    CODED,
    Choice,
    Exposure,
    ExposureFinder,
    best_possible,
    check_light,
    judged_exposures,
)
from cep.search.optimized_code import certificate_warnings
from cep.search.playable import unplayable
from cep.search.problem import SearchProblem
from cep.search.search_result import Stopped
from cep.search.verdict import Verdict
from lab.frames.annealing import FramesResult, anneal_frames, joint_figures
from motdiff.files.outputs import new_files

# ends an annealing at its start: the best of its starting codes is returned
_NO_TIME_S = 1e-9


@dataclass(frozen=True)
class Together:
    """Figures of frames that are restored together, as every command's JSON names a code's.

    Attributes
    ----------
    min_mtf : float
        Of the root of the sum of |H|^2, as sampled.
    min_chip : float or None
        The same of |P| on the unit circle, where only the codes' polynomials matter.
    noise_gain_db : float or None
        None above 100 dB.
    """

    min_mtf: float
    min_chip: float | None
    noise_gain_db: float | None


@dataclass(frozen=True)
class FramesOptimum:
    """Searched codes of several frames, and what they are worth.

    Attributes
    ----------
    problem : SearchProblem
    how : SearchOptions
    search : FramesResult
        What ended it may also have ended the search of the single code.
    metrics : tuple of CodeMetrics
        Of each code by itself.
    joint : Together
        Of the codes.
    single : ShutterCode
        The best code for a single frame.
    repeated : Together
        Of that code played in every frame.
    verdict : Verdict
        Whether to use the codes, by the restoration from all frames that is expected with the
        problem's camera.
    """

    problem: SearchProblem
    how: SearchOptions
    search: FramesResult
    metrics: tuple[CodeMetrics, ...]
    joint: Together
    single: ShutterCode
    repeated: Together
    verdict: Verdict

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        moves = self.how.moves(searched_problem(self.problem))
        return (
            *ended_early(self.how, self.search.stopped, moves),
            *certificate_warnings(self.problem),
        )

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``python -m lab frames --json`` prints them."""
        outcome = self.search
        return {
            "verdict": self.verdict.sentence,
            "choice": self.verdict.choice,
            "gains_db": self.verdict.gains_db,
            "bits": [code.bits for code in outcome.codes],
            "frames": len(outcome.codes),
            "chips": self.problem.chips,
            "open": [code.open_chips for code in outcome.codes],
            "chip_ns": self.problem.chip_ns,
            **asdict(self.joint),
            "objective": outcome.objective,
            "each": [metrics.to_dict() for metrics in self.metrics],
            "single": {
                "bits": self.single.bits,
                "open": self.single.open_chips,
                **asdict(self.repeated),
            },
            "seconds": outcome.seconds,
            "steps": outcome.steps,
            "stopped": outcome.stopped,
            "interrupted": outcome.stopped == "interrupted",
        }

    def stored(self, *, source: Mapping[str, object] | None = None) -> list[StoredCode]:
        """Return what the ``code.json`` of each frame holds.

        Parameters
        ----------
        source : mapping, optional
            Where the motion comes from.
        """
        figures = [metrics.to_dict() for metrics in self.metrics]
        about = {
            **(source or {}),
            **_described(self.problem, self.how, self.search),
            "joint": asdict(self.joint),
        }
        return [
            StoredCode(code, code_figures, {**about, "frame": number})
            for number, (code, code_figures) in enumerate(
                zip(self.search.codes, figures, strict=True), 1
            )
        ]

    def save(self, files: Sequence[Path], *, source: Mapping[str, object] | None = None) -> None:
        """Write :meth:`stored`, a file for each frame: all of them or none."""
        with new_files(files) as temporary:
            for file, stored in zip(files, self.stored(source=source), strict=True):
                write_code(temporary[file], stored)


def optimize_frames(
    problem: SearchProblem,
    how: SearchOptions,
    frames: int,
    *,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    on_found: Callable[[list[StoredCode]], None] = lambda _stored: None,
) -> FramesOptimum:
    """Search the codes of several frames, and measure them beside one code in every frame.

    Parameters
    ----------
    problem : SearchProblem
    how : SearchOptions
        By annealing. Half the time at most goes to the single code; both searches make as many
        moves.
    frames : int
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_found : callable, optional
        Called with the codes before they are measured.

    Raises
    ------
    ValueError
        If the method is another, there is no frame, even the shortest opening saturates at the
        problem's light, or the device cannot play a code.
    """
    if how.method != "anneal":
        raise ValueError(
            f"frames: not valid with method={how.method!r}, which searches a single code"
        )
    check_light(problem)
    single, searched = _search(
        searched_problem(problem), how, frames, mean_length_px(problem), progress
    )
    outcome = replace(
        searched, codes=tuple(replace(code, chip_ns=problem.chip_ns) for code in searched.codes)
    )
    for code in outcome.codes:
        if reason := unplayable(code.bits, problem.device, code.chip_ns):
            raise ValueError(reason)
    about = _described(problem, how, outcome)
    on_found(
        [
            StoredCode(code, problem={**about, "frame": number})
            for number, code in enumerate(outcome.codes, 1)
        ]
    )

    def together(codes: Sequence[ShutterCode]) -> Together:
        joint = joint_figures(problem, codes)
        min_chip = None
        noise_gain_db = None
        if problem.on_circle:
            # as sampled, in chips: no certificate covers several codes
            circle = replace(problem, scenarios=())
            min_chip = problem.chips * joint_figures(circle, codes).minimum
        if joint.noise_gain_db <= HOPELESS_DB:
            noise_gain_db = joint.noise_gain_db
        return Together(joint.minimum, min_chip, noise_gain_db)

    metrics = tuple(problem.measure(code) for code in outcome.codes)
    joint = together(outcome.codes)
    repeated = together([single] * frames)
    judgement = frames_verdict(problem, outcome.codes)
    progress(1.0, "")
    return FramesOptimum(problem, how, outcome, metrics, joint, single, repeated, judgement)


def _described(
    problem: SearchProblem, how: SearchOptions, outcome: FramesResult
) -> dict[str, Any]:
    """Describe the search of all frames, as each one's code file does."""
    return {
        **described_search(problem, how, steps=outcome.steps, stopped=outcome.stopped),
        "frames": len(outcome.codes),
        "bits_of_frames": [code.bits for code in outcome.codes],
    }


def frames_verdict(problem: SearchProblem, codes: Sequence[ShutterCode]) -> Verdict:
    """Judge the codes of several frames beside one exposure repeated in every frame.

    Parameters
    ----------
    problem : SearchProblem
        Its path counts as known exactly.
    codes : sequence of ShutterCode
        Of each frame. Where they open once each, all of them alike, they count as that single
        exposure.

    Raises
    ------
    ValueError
        If the problem has no motion, or even the shortest opening saturates at its light.
    """
    check_light(problem)
    frames = len(codes)
    camera = problem.camera
    # M frames have an Mth of the noise, for which another length of exposure may be the best
    ordinary = ExposureFinder(problem).ordinary(camera, every_length=True)
    alike = len({code.bits for code in codes}) == 1  # then they are a way repeated, like others
    kind: Choice = "code"
    if all(code.pulses == 1 for code in codes):
        kind = "snapshot"
    exposures = judged_exposures(
        problem,
        [camera],
        [*ordinary, *codes[: int(alike)]],
        path_error_px=0.0,
        frames=frames,
    )[0]
    searched = exposures[-1]
    if not alike:
        # different codes fill each other's zeros, which no single code with less noise does
        noise = [
            model(camera, codes, response=problem.response, scene=problem.scene)
            for model in (light_noise, equal_light_noise)
        ]
        at_time, at_light = joint_psnr_db(problem, codes, noise=noise)
        frame_exposures = judged_exposures(problem, [camera], codes, path_error_px=0.0)[0][1:]
        searched = Exposure(
            kind,
            codes[0],
            float(at_time),
            float(at_light),
            all(exposure.within_limits for exposure in frame_exposures),
            any(exposure.saturates for exposure in frame_exposures),
        )
        exposures = (*exposures, searched)
    best_possible(exposures)
    if searched.possible and searched.kind in CODED:
        return Verdict(
            camera, exposures, "these codes", searched, frames=frames, scene=problem.scene
        )
    return Verdict(camera, exposures, "", frames=frames, scene=problem.scene)


def _search(
    problem: SearchProblem,
    how: SearchOptions,
    frames: int,
    length_px: float,
    progress: Callable[[float, str], None],
) -> tuple[ShutterCode, FramesResult]:
    """Search the best single code, then all frames' from it."""
    moves = how.moves(problem)
    time_s = how.limit_s
    progress(0.0, "a single code")
    single = search_code(
        problem,
        replace(how, steps=moves, time_s=time_s / 2),
        length_px=length_px,
        progress=lambda share, best: progress(share / 2, f"a single code, {best.open_chips} open"),
    )
    left_s = max(time_s / 2, time_s - single.seconds)  # baselines may overrun their half
    if single.stopped == "interrupted":
        left_s = _NO_TIME_S  # Ctrl-C ends both searches; a time limit only the one
    outcome = anneal_frames(
        problem,
        frames,
        rng=np.random.default_rng([how.seed, 3]),  # other draws than the single code's
        steps=moves,
        time_s=left_s,
        start=[[single.code] * frames],  # so that the codes together are never worse than it
        progress=lambda share, best: progress(
            (1 + share) / 2, f"{'+'.join(str(code.open_chips) for code in best)} open"
        ),
    )
    # of both searches, the end that left the most undone
    worst: list[Stopped] = ["interrupted", "time", "steps", "complete"]
    return single.code, replace(
        outcome, stopped=min(single.stopped, outcome.stopped, key=worst.index)
    )
