"""Exposures, measured: simulated on photographs and restored, instead of a model's figure.

A measurement takes seconds, which a page that follows a hand, and a first sentence, do not have.
They shift the model by a table of cases that were measured before, by
``python -m lab.photo_gains.table``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO
from cep.optics.straight_motion import straight_axis
from cep.photographs import scenes
from cep.photographs.trial import PhotoTrial, grid_px
from cep.search.expected import WORTH_DB
from cep.search.exposures import CODED, Choice, Exposure
from cep.search.frame_error import FrameError, is_framed
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

LONGEST_PX = 128.0
"""Extent of a motion beyond which a measurement would take minutes, and the model is left."""

GAINS_TABLE = Path(__file__).with_name("gains.csv")
"""Gains over the open shutter of the best single exposure and the best code, by the model and on
photographs."""

_Key = tuple[Choice, str]

# distances at which a case of the table counts e^-1/2: a third of a step between its cases
_DECADES = 0.4  # of light and of read noise
_OCTAVES = 0.5  # of the extent
_BENT = 2.0  # straight and bent paths count half a step apart
_FIRST_ROUNDS = (3, 6)  # photographs after which half of the candidates is left, and one
_LENGTHS = 6  # of single exposures, the best by the model, that are tried
_CODES = 4  # of the search's that are tried: the best by the model
# Where codes are judged in a photo with borders too: the best there, and the best by the model,
# which alone counts the error of a path.
_IN_FRAME = 3
_BY_MODEL = 1
_BY_MODEL_OF_AN_ESTIMATE = 4
_OWN_CODES = 3  # of the user's that are all measured on every photograph
_USUAL_PX = 4e4  # of a restored photo; larger ones are restored from fewer photographs
_LEAST_PHOTOGRAPHS = 4


def measured_exposures(
    problem: SearchProblem,
    modelled: Sequence[Exposure],
    *,
    photographs: Sequence[FloatArray] | None = None,
    own_codes: Iterable[ShutterCode] = (),
    path_error_px: float = 0.0,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Exposure, ...]:
    """Measure the exposures that may be the best of their kind on photographs.

    These are the open shutter, single exposures of six lengths near the model's best, the best
    even pulses and codes, the user's codes, and the best one outside the limits. Of several of a
    kind half are left after 3 photographs and one after 6, which is measured on all. The others
    are stated relative to it.

    Parameters
    ----------
    problem : SearchProblem
    modelled : sequence of Exposure
        As the model judges them at the problem's light, the open shutter first.
    photographs : sequence of (H, W) float ndarrays, linear light, optional
        When omitted those of :func:`cep.photographs.scenes.photographs` where the problem's scene
        is photographs, else none.
    own_codes : iterable of ShutterCode
    path_error_px : float
        As of :func:`cep.search.advise.advise`.
    seed : int
        Of the noise and the errors of the path.
    progress : callable, optional
        Called with the finished share, 0..1.

    Returns
    -------
    tuple of Exposure
        The open shutter first, then those that were measured. What the model judged where there
        are no photographs, or the motion is longer than :data:`LONGEST_PX`.
    """
    if not is_measured(problem, photographs):
        return tuple(modelled)
    motions = problem.directed_paths()
    photographs = _pictures(problem, photographs)
    size = grid_px(motions)
    affordable = int(len(photographs) * _USUAL_PX / size)
    count = min(len(photographs), max(affordable, _LEAST_PHOTOGRAPHS))
    trial = PhotoTrial(
        motions,
        photographs[:count],
        camera=problem.camera,
        response=problem.response,
        chip_ns=problem.chip_ns,
        path_error_px=path_error_px,
        seed=seed,
    )
    played = _played_by_two if problem.frames == 2 else _played
    groups = _candidates(
        problem,
        modelled,
        {code.bits for code in own_codes},
        choices=_BY_MODEL_OF_AN_ESTIMATE if path_error_px > 0 else _BY_MODEL,
    )
    rounds = [*(number for number in _FIRST_ROUNDS if number < count), count]
    # the number of photos of each group in each round is known before
    planned = sum(_photos(len(group), rounds) for group in groups)
    finished = 0

    def measure(group: Sequence[Exposure], numbers: range) -> FloatArray:
        nonlocal finished
        levels = trial.psnr_db(
            [played(exposure) for exposure in group],
            numbers,
            tell=lambda photos: progress((finished + photos) / planned),
        )
        finished += levels.size
        return levels

    measured: dict[_Key, Exposure] = {}
    for group in groups:
        measured |= {_key(exposure): exposure for exposure in _halved(group, rounds, measure)}
    return tuple(measured[_key(exposure)] for exposure in modelled if _key(exposure) in measured)


def _key(exposure: Exposure) -> _Key:
    """Kind and code: of two cameras a single opening in both is none, with its rest, in each."""
    return exposure.kind, exposure.code.bits


def _played(exposure: Exposure) -> tuple[ShutterCode, ...]:
    return (exposure.code,)


def _played_by_two(exposure: Exposure) -> tuple[ShutterCode, ...]:
    """Return the codes of two cameras: a code and its complement, or one exposure in both."""
    if exposure.kind in CODED:
        return exposure.code, exposure.code.complement()
    return exposure.code, exposure.code


def is_measured(problem: SearchProblem, photographs: Sequence[FloatArray] | None = None) -> bool:
    """Whether there are photographs, and the motion is no longer than :data:`LONGEST_PX`."""
    longest_px = max(path.extent_px for path in problem.directed_paths())
    return len(_pictures(problem, photographs)) > 0 and longest_px <= LONGEST_PX


def _pictures(
    problem: SearchProblem, photographs: Sequence[FloatArray] | None
) -> Sequence[FloatArray]:
    """Return the photographs, or the bundled ones of a problem whose scene is photographs."""
    if photographs is not None:
        return photographs
    return scenes.photographs() if problem.scene.name == PHOTO.name else ()


def corrections_db(
    modelled: Iterable[Exposure], measured: Iterable[Exposure]
) -> dict[Choice, float]:
    """Return what the model lacks on photographs, dB, of the best exposure of each kind."""
    model_db = {exposure.code.bits: exposure.psnr_db for exposure in modelled}
    best: dict[Choice, Exposure] = {}
    for exposure in sorted(measured, key=lambda exposure: exposure.psnr_db):
        best[exposure.kind] = exposure
    return {
        kind: exposure.psnr_db - model_db[exposure.code.bits] for kind, exposure in best.items()
    }


def corrected(exposure: Exposure, corrections: dict[Choice, float], share: float) -> Exposure:
    """Shift an exposure's modelled figures by a share of the correction of its kind."""
    correction = corrections.get(exposure.kind)
    if correction is None:  # a kind that was not measured: as the others, which leaves its gains
        correction = float(np.mean([*corrections.values()] or [0.0]))
    return replace(
        exposure,
        psnr_db=exposure.psnr_db + share * correction,
        equal_light_db=exposure.equal_light_db + share * correction,
    )


def _candidates(
    problem: SearchProblem, modelled: Sequence[Exposure], own_bits: set[str], *, choices: int
) -> list[list[Exposure]]:
    """Return groups of exposures that compete; a group of one is measured on all photographs.

    Of codes that are judged in a photo with borders the best ``choices`` by the model are among
    them in any case.
    """
    by_model = sorted(modelled[1:], key=lambda exposure: -exposure.psnr_db)
    possible = [exposure for exposure in by_model if exposure.possible]
    groups = []
    # what loosening the limits would gain
    unlimited = [exposure for exposure in by_model if not exposure.saturates]
    if unlimited and not unlimited[0].within_limits:
        beyond_db = unlimited[0].psnr_db - (possible[0].psnr_db if possible else -np.inf)
        if beyond_db > WORTH_DB:
            groups.append(unlimited[:1])
    user_exposures = [exposure for exposure in modelled if exposure.code.bits in own_bits]
    if len(user_exposures) <= _OWN_CODES:
        groups += [[exposure] for exposure in user_exposures]
    else:
        groups.append(user_exposures)
    codes = [exposure for exposure in possible if exposure.kind == "code"]
    if is_framed(problem):
        errors_db = FrameError(problem).of_codes_db([exposure.code for exposure in codes])
        in_frame = [codes[index] for index in np.argsort(errors_db, kind="stable")]
        codes = [*dict.fromkeys([*codes[:choices], *in_frame])][: choices + _IN_FRAME]
    else:
        codes = codes[:_CODES]
    strobes = [exposure for exposure in possible if exposure.kind == "strobe"][:1]
    snapshots = [exposure for exposure in possible if exposure.kind == "snapshot"]
    best_of_length: dict[int, Exposure] = {}
    for exposure in snapshots:
        best_of_length.setdefault(exposure.code.open_chips, exposure)
    # with a brighter lamp the best may be another
    at_equal_light = sorted(snapshots, key=lambda exposure: -exposure.equal_light_db)[:1]
    shortlist = dict.fromkeys([*[*best_of_length.values()][:_LENGTHS], *at_equal_light])
    groups += [[*codes, *strobes], [*shortlist], [modelled[0]]]
    # of several groups the first counts: those before the codes are measured in full
    group_of: dict[_Key, int] = {}
    for index, group in enumerate(groups):
        for exposure in group:
            group_of.setdefault(_key(exposure), index)
    distinct = [
        [exposure for exposure in group if group_of[_key(exposure)] == index]
        for index, group in enumerate(groups)
    ]
    return [group for group in distinct if group]


def _remaining(candidates: int, number: int, rounds: Sequence[int]) -> int:
    """How many candidates are left after a round of so many photographs."""
    return -(-candidates // 2) if number == rounds[0] else 1


def _photos(candidates: int, rounds: Sequence[int]) -> int:
    """Count the photos that a group's competition takes."""
    total = 0
    before = 0
    for number in rounds:
        total += candidates * (number - before)
        before = number
        candidates = _remaining(candidates, number, rounds)
    return total


def _halved(
    group: Sequence[Exposure],
    rounds: Sequence[int],
    measure: Callable[[Sequence[Exposure], range], FloatArray],
) -> list[Exposure]:
    """Measure a group, ever fewer of it on more photographs."""
    remaining = list(group)
    levels = np.empty((len(group), 0))
    # with what each is behind the best of its round
    lost: list[tuple[Exposure, FloatArray, float]] = []
    for number in rounds:
        levels = np.hstack([levels, measure(remaining, range(levels.shape[1], number))])
        order = np.argsort(-levels.mean(axis=1), kind="stable")
        keep = _remaining(len(remaining), number, rounds)
        best_db = levels[order[0]].mean()
        lost += [(remaining[i], levels[i], best_db - levels[i].mean()) for i in order[keep:]]
        remaining = [remaining[i] for i in order[:keep]]
        levels = levels[order[:keep]]
    best = _stated(remaining[0], levels[0])
    return [best] + [
        _stated(exposure, photos, psnr_db=best.psnr_db - behind_db)
        for exposure, photos, behind_db in lost
    ]


def _stated(modelled: Exposure, photos_db: FloatArray, psnr_db: float | None = None) -> Exposure:
    """Exposure with its measured figures; the model's at equal light is shifted as much."""
    if psnr_db is None:
        psnr_db = float(photos_db.mean())
    return replace(
        modelled,
        psnr_db=float(psnr_db),
        equal_light_db=modelled.equal_light_db + float(psnr_db) - modelled.psnr_db,
        photo_psnr_db=tuple(photos_db.tolist()),
    )


def shifts_db(path: Trajectory, camera: Camera) -> dict[Choice, float]:
    """Return what the model's gains over the open shutter lack on photographs, dB, by kind.

    The mean over the table's cases, each with a weight that falls with the distance in light, read
    noise and extent of the motion. Cases far from all of them get the nearest one's.

    Parameters
    ----------
    path : Trajectory
    camera : Camera
    """
    places, lacks_db = _measured_cases()
    # what of the noise does not come from the light: quantisation counts as well
    photons = camera.photons_full_scale
    variance = float(camera.noise_variance(PHOTO.mean)) - PHOTO.mean / photons
    fixed_e = photons * float(np.sqrt(max(variance, 0.0)))
    place = _place(path.extent_px, straight_axis(path) is not None, photons, fixed_e)
    squares = ((places - place) ** 2).sum(axis=1)
    weights = np.exp(-(squares - squares.min()) / 2)
    snapshot_db, code_db = (weights @ lacks_db / weights.sum()).tolist()
    return {"open": 0.0, "snapshot": snapshot_db, "strobe": code_db, "code": code_db}


@cache
def _measured_cases() -> tuple[FloatArray, FloatArray]:
    """Places of the table's cases, and what the model lacks there, dB: snapshot and code."""
    cases = np.genfromtxt(GAINS_TABLE, delimiter=",", names=True, dtype=None, encoding="utf-8")
    places = _place(cases["extent_px"], cases["straight"], cases["photons"], cases["read_noise_e"])
    kinds = ("snapshot", "code")
    lacks_db = [cases[f"{kind}_measured_db"] - cases[f"{kind}_model_db"] for kind in kinds]
    return places, np.stack(lacks_db, axis=-1)


def _place(
    extent_px: ArrayLike, straight: ArrayLike, photons: ArrayLike, read_noise_e: ArrayLike
) -> FloatArray:
    """Place of a case, in steps at which it counts e^-1/2, along the last axis."""
    steps = (
        np.log10(photons) / _DECADES,
        np.log10(np.maximum(read_noise_e, 1.0)) / _DECADES,
        np.log2(np.maximum(extent_px, 1.0)) / _OCTAVES,
        np.asarray(straight) / _BENT,
    )
    return np.stack(steps, axis=-1)
