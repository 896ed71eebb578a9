"""What the two networks add to ``pmp`` in ``cep calibrate``, by motion, noise and detail.

    python -m lab.studies.motdiff_gain rows FILE --prepared CONFIG [--draws 8]
    python -m lab.studies.motdiff_gain rows FILE --data DIR --protocol NAME [--gyro RECORDING]
    python -m lab.studies.motdiff_gain table FILE...

The first form takes the held-out photos of a run. The figures are paired differences of MNC.

Each photo is estimated by ``pmp``, by ``motdiff``, and by two others, which each lack one of its
networks. ``pmp+`` is ``pmp`` with the refinement and the correction of ``motdiff``: all of it but
the diffusion network. ``uncorrected`` is ``motdiff`` without the correction. A search that two of
them need is run once, and its time counts for each. CONFIG is a run's TOML file with prepared
samples; there the diffusion network alone is measured too. DIR and NAME are those of ``python -m
lab bench blind``. One thread; a row is appended as soon as it is done, and an interrupted bench
goes on where it stopped: a row says its photos and the version of the estimators.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lab.bench.blind.cases import make_case
from lab.bench.blind.plan import blind_plan
from lab.bench.blind.protocol import Protocol
from lab.bench.statistics import mean_interval
from lab.evaluation.draws import measure_draws
from lab.evaluation.sets import levin_photo
from lab.jobs.cells import Cell
from lab.studies.inputs import (
    add_row,
    case_key,
    case_rows,
    check_version,
    kept_rows,
    refusals,
    study_parser,
    study_version,
)
from motdiff.blind_search.coarse_to_fine import refined
from motdiff.estimators.base import Estimator, FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator
from motdiff.estimators.kernel_score import distinct, rank_kernels
from motdiff.estimators.motdiff.drawing import draw_psfs
from motdiff.estimators.motdiff.estimator import MotDiffEstimator, corrected_choice
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.files.gyro_tables import read_gyro
from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.network.correction import CorrectionNetwork, corrected_kernel
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.sampling import psfs_of_maps
from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.photo_values import luminance
from motdiff.progress import Progress
from motdiff.threads import one_thread, side_by_side
from motdiff.training.config import read_config
from motdiff.training.motion_bank import drawn_kinds
from motdiff.training.prepared import read_shards
from motdiff.weights import load_correction, load_network

FloatArray = np.ndarray

METHODS = ("pmp", "pmp+", "uncorrected", "motdiff")
_STEPS = (1, 10)
_LAST_DRAWS = "ddim:10, corrected"
_REFINED = 3  # as in MotDiffEstimator
_NOISE = (0.003, 0.009)  # 0.01 of full scale is found as 0.0095 to 0.0105
_CONFIDENCE = (0.7, 0.9)
_LEAST_SCENES = 4  # fewer give no interval
_CHANGED = 0.02  # a kernel that is better or worse by more counts as won or lost
_KINDS = {
    "boracchi_foi": "walks of full length",
    "boracchi_foi_short": "shorter walks",
    "gyro": "hand shake",
    "straight": "straight or accelerated",
    "quadratic": "straight or accelerated",
    "real": "real",
}


@dataclass(frozen=True)
class Photo:
    """A photo of a known motion: its name, kind of motion and scene, and the network's conditions
    where prepared.
    """

    name: str
    kind: str
    scene: str
    light: FloatArray
    psf: FloatArray
    conditions: FloatArray | None = None


class SharedSearches:
    """Searches of one photo, each run once whatever the number of methods that need it.

    Attributes
    ----------
    spared_s : float, seconds
        Processor time that repeated searches would have taken.
    """

    def __init__(self) -> None:
        self._kernels: dict[tuple[str, bytes], tuple[Any, float]] = {}
        self.spared_s = 0.0

    def run(
        self, search: Callable[..., Any], crops: FloatArray, *plan: Any, **options: Any
    ) -> Any:
        """Search the crops (C, H, W), or give what was found before."""
        key = search.__qualname__, crops.tobytes()
        if key in self._kernels:
            self.spared_s += self._kernels[key][1]
        else:
            began_s = time.process_time()
            kernels = search(crops, *plan, **options)
            self._kernels[key] = kernels, time.process_time() - began_s
        return self._kernels[key][0]

    def forget(self) -> None:
        """Forget the kernels, before another photo."""
        self._kernels.clear()


class Pmp(PmpEstimator):
    """PMP that shares the searches of its starts."""

    def __init__(self, shared: SharedSearches) -> None:
        super().__init__()
        self._shared = shared

    def kernels(self, crops: FloatArray, **options: Any) -> list[FloatArray]:
        """Search kernels from each start, or give those of before."""
        return list(self._shared.run(super().kernels, crops, **options))


class PmpCorrected(Pmp):
    """PMP whose three likeliest different kernels are refined and judged again, and the best of
    these corrected.
    """

    method = "pmp+"

    def __init__(self, shared: SharedSearches) -> None:
        super().__init__(shared)
        self._correction = load_correction()

    def search(
        self,
        crops: FloatArray,
        progress: Progress,
        halved: Callable[[], FloatArray] | None = None,  # noqa: ARG002, the base class's
    ) -> FoundKernels:
        """Run the starts on the crops (C, H, W), and refine the likeliest kernels."""
        kernels = self.kernels(crops, progress=progress)
        alike = mnc_matrix(kernels)
        order = np.argsort(-rank_kernels(crops, kernels).probabilities)
        chosen = distinct(alike, order[:1], order[1:], count=_REFINED)
        sharpened = side_by_side(
            [partial(refined, crops, kernels[i], shared_sigma(crops)) for i in chosen]
        )
        for i, kernel in zip(chosen, sharpened, strict=True):
            kernels[i] = kernel
        probabilities = rank_kernels(crops, kernels).probabilities
        best = max(chosen, key=lambda i: probabilities[i])
        return FoundKernels(tuple(kernels), probabilities, best, {})

    def corrected(
        self,
        crops: FloatArray,
        kernels: FoundKernels,
        progress: Progress,  # noqa: ARG002
    ) -> FoundKernels:
        """Correct the kernels as ``motdiff`` does."""
        return corrected_choice(self._correction, crops, kernels, count=_REFINED)


class MotDiff(MotDiffEstimator):
    """MoTDiff that shares its search."""

    def __init__(self, shared: SharedSearches) -> None:
        super().__init__()
        self._shared = shared

    def search(self, crops: FloatArray, *plan: Any, **options: Any) -> FoundKernels:
        """Search kernels, or give those of before."""
        kernels: FoundKernels = self._shared.run(super().search, crops, *plan, **options)
        return kernels


class Uncorrected(MotDiff):
    """MoTDiff without the correction."""

    method = "uncorrected"
    corrected = BlindEstimator.corrected


def prepared_photos(config_file: Path) -> Iterator[Photo]:
    """Held-out samples of a run."""
    config = read_config(config_file)
    samples = read_shards(config.data.prepared_validation)
    kinds = drawn_kinds(config.motions, count=len(samples), seed=config.optimiser.seed + 1)
    truth = psfs_of_maps(samples.dwell[:, 0].float()).double().numpy()

    def sample(i: int) -> Photo:
        light = samples.photos[i, 0].double().div(255).square().numpy()
        kernels = samples.kernels[i].double().numpy()
        return Photo(f"{i:04d}", kinds[i], f"{i:04d}", light, truth[i], kernels)

    return map(sample, range(len(kinds)))  # what cannot be read is refused before


def protocol_photos(folder: Path, protocol: Protocol, recording: Path | None) -> Iterator[Photo]:
    """Photos of a blind table, or Levin's."""
    trace = None if recording is None else read_gyro(recording)
    cells = blind_plan(protocol, ["pmp"], folder=folder, trace=trace).cells

    def photo(cell: Cell) -> Photo:
        _, scene, shake, _ = cell.name
        simulated = "shot" in cell.arguments
        if simulated:
            case = make_case(*(cell.arguments[name] for name in ("photo", "motion", "shot")))
        else:
            case = levin_photo(cell.arguments["photo"])
        kind = "real" if not simulated else "gyro" if protocol.motion.gyro else "boracchi_foi"
        return Photo(f"{scene}/{shake}", kind, scene, case.photo, case.psf)

    return map(photo, [cell for cell in cells if cell.name[0] == "pmp"])


def estimators(shared: SharedSearches) -> dict[str, Estimator]:
    """Make the methods."""
    methods = (Pmp(shared), PmpCorrected(shared), Uncorrected(shared), MotDiff(shared))
    return {estimator.method: estimator for estimator in methods}


def row_of(
    photo: Photo, methods: dict[str, Estimator], shared: SharedSearches
) -> dict[str, object]:
    """Estimate one photo by every method."""
    grey = luminance(photo.light)
    gradients = np.concatenate([np.diff(grey, axis=axis).ravel() for axis in (0, 1)])
    sigma = noise_sigma(grey)
    row: dict[str, object] = {
        "name": photo.name,
        "kind": photo.kind,
        "scene": photo.scene,
        "sigma": sigma,
    }
    row["detail"] = float(np.sqrt(max(np.mean(gradients**2) - 2 * sigma**2, 0.0)))
    for name, estimator in methods.items():
        shared.spared_s, began_s = 0.0, time.process_time()
        estimate = estimator.estimate(photo.light)
        cpu_s = time.process_time() - began_s + shared.spared_s
        mnc = mnc_subpixel(estimate.psf, photo.psf)
        row[name] = {
            "mnc": mnc,
            "confidence": estimate.confidence,
            "cpu_s": cpu_s,
            **_chosen(estimate.details),
        }
    shared.forget()
    return row


def _chosen(details: object) -> dict[str, object]:
    return (
        {"chosen": details["chosen"]} if isinstance(details, dict) and "chosen" in details else {}
    )


def drawn(
    network: MotDiffNetwork, correction: CorrectionNetwork, photo: Photo, count: int, number: int
) -> dict[str, object]:
    """Draws of the network alone, told of the kernels prepared with the photo, and the same
    corrected.
    """
    figures: dict[str, object] = {}
    crops = luminance(photo.light)[None]
    assert photo.conditions is not None
    conditions = list(photo.conditions[:2])
    for steps in _STEPS:
        draws = draw_psfs(
            network,
            crops,
            photo.conditions,
            count=count,
            steps=steps,
            generator=torch.Generator().manual_seed(number),
        )
        better = [
            corrected_kernel(correction, crops, draw, conditions, sigma=shared_sigma(crops))
            for draw in draws
        ]
        for name, kernels in (
            (f"ddim:{steps}", list(draws)),
            (f"ddim:{steps}, corrected", better),
        ):
            draw_figures = measure_draws(kernels, photo.psf)
            mncs = [mnc_subpixel(kernel, photo.psf) for kernel in kernels]
            figures[name] = {
                "mnc": mncs,
                "best": draw_figures.best,
                "alike": draw_figures.alike,
                "covered": draw_figures.covered,
            }
    return figures


def missing_rows(
    photos: Iterable[Photo],
    earlier: Mapping[str, Mapping[str, Any]],
    draws: int,
    shared: Mapping[str, object],
) -> Iterator[dict[str, object]]:
    """Measure what the earlier rows lack; ``shared`` is what cases say beside the photo's name."""
    searches = SharedSearches()
    methods = estimators(searches)
    network = load_network()
    correction = load_correction()
    for number, photo in enumerate(photos):
        case = {"name": photo.name, **shared}
        figures = earlier.get(case_key(case), {})
        missing = {name: method for name, method in methods.items() if name not in figures}
        draws_missing = photo.conditions is not None and draws > 1 and draw_count(figures) != draws
        if not missing and not draws_missing:
            continue
        row = {"case": case, **row_of(photo, missing, searches)}
        if draws_missing:
            row |= drawn(network, correction, photo, draws, number)
        yield row


def draw_count(row: Mapping[str, Any]) -> int:
    """Count the draws of each kind that a row has."""
    return len(row[_LAST_DRAWS]["mnc"]) if _LAST_DRAWS in row else 0


def merged_rows(lines: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a file; the lines of one case are one row."""
    rows: dict[str, dict[str, Any]] = {}
    for line in lines:
        rows.setdefault(case_key(line.get("case", {"name": line["name"]})), {}).update(line)
    return list(rows.values())


def groups(rows: list[dict[str, Any]]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """All rows, and those of each kind of motion, level of noise, third of detail, and confidence
    of ``pmp``.
    """
    yield "all", rows
    for kind in dict.fromkeys(_KINDS.values()):
        yield kind, [row for row in rows if _KINDS[row["kind"]] == kind]
    thirds = tuple(
        float(x) for x in np.quantile([row["detail"] for row in rows], (1 / 3, 2 / 3)).round(3)
    )
    levels: tuple[tuple[str, tuple[float, ...], Callable[[dict[str, Any]], float]], ...] = (
        ("noise", _NOISE, lambda row: row["sigma"]),
        ("detail", thirds, lambda row: row["detail"]),
        ("confidence of pmp", _CONFIDENCE, lambda row: row["pmp"]["confidence"]),
    )
    for name, (low, high), value in levels:
        yield f"{name} below {low:g}", [row for row in rows if value(row) < low]
        yield f"{name} {low:g} to {high:g}", [row for row in rows if low <= value(row) < high]
        yield f"{name} {high:g} or more", [row for row in rows if value(row) >= high]


def difference(rows: list[dict[str, Any]], first: str, second: str) -> str:
    """Mean paired difference with its 95 % interval, photos of one scene drawn together."""
    less = [row[first]["mnc"] - row[second]["mnc"] for row in rows]
    interval = mean_interval(
        less, rng=np.random.default_rng(0), clusters=[row["scene"] for row in rows]
    )
    if interval.clusters < _LEAST_SCENES or not np.isfinite(interval.low):
        return f"{interval.mean:.3f}"
    return f"{interval.mean:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def line(name: str, rows: list[dict[str, Any]]) -> str:
    """Line of the table: means, paired differences, and the photos whose kernel became clearly
    better or worse.
    """
    means = " | ".join(
        format(np.mean([row[method]["mnc"] for row in rows]), ".3f") for method in METHODS
    )
    less = " | ".join(difference(rows, "motdiff", rival) for rival in METHODS[:-1])
    change = np.array([row["motdiff"]["mnc"] - row["pmp"]["mnc"] for row in rows])
    changed = f"{np.sum(change > _CHANGED)}, {np.sum(change < -_CHANGED)}"
    return f"| {name} | {len(rows)} | {means} | {less} | {changed} |"


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of the tables: sub-pixel MNC by group, and draws of the networks."""
    complete = [row for row in rows if all(name in row for name in METHODS)]
    if len(complete) < len(rows):
        yield f"left out: {len(rows) - len(complete)} photos that lack a method\n"
    if not complete:
        return
    rivals = " | ".join(f"less {name}" for name in METHODS[:-1])
    yield f"| photos | n | {' | '.join(METHODS)} | {rivals} | won, lost |"
    yield f"|---|{'---:|' * (len(METHODS) + 1)}{'---|' * (len(METHODS) - 1)}---:|"
    for name, group in groups(complete):
        if group:
            yield line(name, group)
    names = [f"ddim:{steps}{ending}" for steps in _STEPS for ending in ("", ", corrected")]
    for count, name in product(sorted({draw_count(row) for row in rows} - {0}), names):
        of = [row[name] for row in rows if draw_count(row) == count]
        single, best, alike, covered = (
            np.mean([np.mean(figures[key]) for figures in of])
            for key in ("mnc", "best", "alike", "covered")
        )
        yield (
            f"\nDraws, {name}, {len(of)} photos: one draw {single:.3f}, best of"
            f" {count} {best:.3f}, two draws alike {alike:.3f}, truth among them {covered:.3f}"
        )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("what", choices=["rows", "table"])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--prepared", type=Path, metavar="CONFIG")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--protocol", default="card-walks")
    parser.add_argument("--gyro", type=Path)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--count", type=int, help="the first photos alone")
    options = parser.parse_args()
    if options.what == "table":
        with refusals(parser):
            rows = [row for file in options.files for row in merged_rows(kept_rows(file))]
            check_version(rows)
        print("\n".join(table(rows)))
        return
    if len(options.files) != 1 or (options.prepared is None) == (options.data is None):
        parser.error("rows: give one FILE, and either --prepared or --data")
    (file,) = options.files
    shared: dict[str, object] = {"version": study_version("motdiff_gain")}
    with refusals(parser):
        earlier = {case_key(row["case"]): row for row in merged_rows(case_rows(file))}
        if options.prepared is not None:
            shared["prepared"] = str(options.prepared)
            photos = prepared_photos(options.prepared)
        else:
            shared |= {
                "data": str(options.data),
                "protocol": options.protocol,
                "gyro": str(options.gyro),
            }
            protocol = Protocol.load(options.protocol)
            photos = protocol_photos(options.data, protocol, options.gyro)
    with torch.no_grad(), one_thread():
        for row in missing_rows(islice(photos, options.count), earlier, options.draws, shared):
            add_row(file, row)


if __name__ == "__main__":
    main()
