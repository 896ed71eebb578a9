"""Real photographs, without sharp ones beside them: which are restored, how, and how they look.

    python -m lab.studies.real_photos PHOTOS... -o FOLDER [--anyway]

Each photo is estimated as ``cep calibrate`` does, restored from itself as ``cep deblur PHOTO``
does, and along the path found as ``cep deblur PHOTO --trajectory`` does. Prints a row each, and
writes ``sheet.png``: the photo, the restored one, and a detail of the photo, of the restored one
and of the one along the path. Look at every pair: no figure sees what an eye sees.

Two figures need no sharp photo, and neither takes part in the program's choices in this form:

- edges: L1 over L2 norm of the gradients, over that of the photo; below 1 where edges are sharper.
- flat: rms of the detail within areas where the photo is flat, within its noise, over the whole
  reach of the blur; as a share of the photo's contrast, before and after. A scene that is flat
  there once it is blurred is flat, but for what the blur takes out entirely. So what a restoration
  shows there was not in the photo: stripes, ringing, grain.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

import cep
from cep.files.foreign_text import plot_text
from cep.files.images import read_photo
from cep.plots.canvas import new_figure, save, show_photo, thumbnail
from cep.plots.photos import busiest
from cep.restoration.blur import trimmed_psf
from cep.restoration.restore import restore
from cep.restoration.result import Restoration
from cep.restoration.sharpen import sharpen
from cep.restoration.tv import gradient_sparsity
from lab.studies.inputs import study_parser
from motdiff.photo_noise import noise_sigma
from motdiff.photo_values import luminance
from motdiff.types import FloatArray

_FLAT_SIGMA = 2.0  # of the noise: detail up to it is none
_LEAST_FLAT = 0.005  # share of the photo's pixels below which nothing is said of flat areas
_SHOWN_PX = 480
_DETAIL_PX = 220


@dataclass(frozen=True)
class Case:
    """A photo, what was made of it, and how long each took, s."""

    name: str
    photo: FloatArray
    confidence: float
    psf: FloatArray
    restored: Restoration
    along: Restoration
    estimate_s: float
    restore_s: float


def cases(files: list[Path], *, anyway: bool) -> Iterator[Case]:
    """Estimate and restore the photos one after another."""
    for file in files:
        photo = read_photo(file).pixels
        started_s = time.perf_counter()
        try:
            estimate = cep.estimate_motion(photo)
        except ValueError as error:
            print(f"| {file.name} | {error} |" + " |" * 8, flush=True)
            continue
        estimated_s = time.perf_counter()
        restored = sharpen(photo, estimate, anyway=anyway)
        restored_s = time.perf_counter()
        yield Case(
            file.name,
            photo,
            estimate.confidence,
            estimate.psf,
            restored,
            restore(photo, trajectory=estimate.best),
            estimated_s - started_s,
            restored_s - estimated_s,
        )


def flat_detail(photo: FloatArray, restored: FloatArray, psf: FloatArray) -> tuple[float, float]:
    """Rms of the detail where the photo is flat, over its contrast, before and after; NaN without.

    Parameters
    ----------
    photo, restored : (H, W) float
    psf : (S, S) float
    """
    side = len(trimmed_psf(psf)) | 1
    sigma = max(noise_sigma(photo), 1e-3)
    mean = ndimage.uniform_filter(photo, side)
    deviation = np.sqrt(np.maximum(ndimage.uniform_filter(photo**2, side) - mean**2, 0))
    flat = deviation < _FLAT_SIGMA * sigma
    flat[: side // 2] = flat[-(side // 2) :] = False  # borders lean on a guess
    flat[:, : side // 2] = flat[:, -(side // 2) :] = False
    if flat.mean() < _LEAST_FLAT:
        return np.nan, np.nan
    before, after = (
        float(np.sqrt(np.mean((image - ndimage.uniform_filter(image, side))[flat] ** 2)))
        for image in (photo, restored)
    )
    contrast = float(np.std(photo))
    return before / contrast, after / contrast


def row(case: Case) -> str:
    """Return the row of a photo."""
    height, width = case.photo.shape[:2]
    photo, restored = luminance(case.photo), luminance(case.restored.image)
    edges = gradient_sparsity(restored) / (gradient_sparsity(photo) or 1.0)
    before, after = flat_detail(photo, restored, case.psf)
    halos = any("halos" in warning for warning in case.along.warnings)
    outcome = case.restored.summary.partition(":")[0] if case.restored.kept else "restored"
    flat = "-" if np.isnan(before) else f"{100 * before:.1f} -> {100 * after:.1f} %"
    return (
        f"| {case.name} | {width} x {height} | {outcome} | {case.restored.method or '-'}"
        f" | {case.confidence:.2f} | {case.estimate_s:.0f} + {case.restore_s:.0f}"
        f" | {edges:.2f} | {flat} | {case.along.method} | {'told' if halos else '-'} |"
    )


def sheet(restored_cases: list[Case], file: Path) -> None:
    """Draw photos and restored ones side by side, with a detail of each."""
    figure = new_figure(17.0, 3.6 * len(restored_cases))
    grid = figure.subplots(len(restored_cases), 5, squeeze=False)
    for axes, case in zip(grid, restored_cases, strict=True):
        side = min(_DETAIL_PX, *case.photo.shape[:2])
        row, column = busiest(case.photo, side)  # of a restored photo it may be noise
        window = (slice(row, row + side), slice(column, column + side))
        state = "kept" if case.restored.kept else f"by {case.restored.method}"
        images = {
            case.name: thumbnail(case.photo, _SHOWN_PX),
            f"{state}, confidence {case.confidence:.2f}": thumbnail(
                case.restored.image, _SHOWN_PX
            ),
            "detail": case.photo[window],
            "detail restored": case.restored.image[window],
            f"along the path, by {case.along.method}": case.along.image[window],
        }
        for axis, (title, image) in zip(axes, images.items(), strict=True):
            show_photo(axis, np.clip(image, 0, 1))
            axis.set_title(plot_text(title), fontsize=7)
    save(figure, file)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path, nargs="+", help="photos, or folders of them")
    parser.add_argument("-o", "--output", type=Path, default=Path("real_photos"))
    parser.add_argument("--anyway", action="store_true", help="restore kept photos all the same")
    options = parser.parse_args()
    files = [
        file
        for place in options.photos
        for file in (sorted(place.iterdir()) if place.is_dir() else [place])
    ]
    options.output.mkdir(parents=True, exist_ok=True)
    print(
        "| photo | px | outcome | method | confidence | s, estimate + restoration | edges | flat"
        " | along the path | halos |"
    )
    print("|---|---|---|---|---:|---:|---:|---|---|---|")
    restored_cases = []
    for case in cases(files, anyway=options.anyway):
        print(row(case), flush=True)
        restored_cases.append(case)
    if not restored_cases:
        return
    sheet(restored_cases, options.output / "sheet.png")
    count = sum(not case.restored.kept for case in restored_cases)
    print(
        f"{count} of {len(restored_cases)} photos restored; look at {options.output / 'sheet.png'}"
    )


if __name__ == "__main__":
    main()
