"""Separation of orders by sets of calibration codes, and the error of blind kernels in that band.

Run with ``python -m lab.studies.calibration_set separation`` or ``... blind``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import fftconvolve

from cep.calibration.order_codes import gray_planes, search_order_codes
from cep.calibration.order_separation import (
    BAND_CY_PX,
    BLIND_ERROR,
    OrderSeparation,
    ordered_walks,
)
from cep.codes.published import published
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.search.limits import Limits
from lab.studies.inputs import photos, study_parser
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.motions import boracchi_foi
from motdiff.types import FloatArray

CHIPS = 52
DESIGN_WALKS = 64
TEST_WALKS = 100
SIDE_PX = 257
NOISE = 0.005


def separation() -> None:
    rng = np.random.default_rng(0)
    design = OrderSeparation(ordered_walks(DESIGN_WALKS, rng=rng), chips=CHIPS)
    test = OrderSeparation(ordered_walks(TEST_WALKS, rng=np.random.default_rng(1)), chips=CHIPS)
    open_shutter = np.ones(CHIPS)
    half = 1 - gray_planes(1, CHIPS)[0]
    raskar = published("raskar-52").code.array
    de_bruijn = np.array(list("00010111"), dtype=float)[np.arange(CHIPS) * 8 // CHIPS]
    random_codes = rng.random((3, CHIPS)).argsort(axis=1) < CHIPS // 2
    rows: dict[str, Sequence[ArrayLike]] = {
        "Raskar-52": [raskar],
        "first half": [half],
        "open, Raskar-52": [open_shutter, raskar],
        "open, first half": [open_shutter, half],
        "open, de Bruijn 8": [open_shutter, de_bruijn],
        "open, Raskar-52, first half": [open_shutter, raskar, half],
        "open, Gray 2": [open_shutter, *gray_planes(2, CHIPS)],
        "open, three random": [open_shutter, *random_codes],
        "open, Gray 3": [open_shutter, *gray_planes(3, CHIPS)],
        "open, Gray 4": [open_shutter, *gray_planes(4, CHIPS)],
    }
    for count in (1, 2, 3, 4):
        for most_open in (CHIPS, CHIPS - 1) if count > 1 else (CHIPS,):
            limits = Limits(CHIPS, (1, most_open))
            name = f"designed, {count}" + ("" if most_open == CHIPS else ", none open")
            rows[name] = search_order_codes(
                limits, count, measure=design, rng=np.random.default_rng(2)
            )
    print(
        "| codes | walks resolved | median | worst tenth | conditioning"
        " |\n|---|---:|---:|---:|---:|"
    )
    for name, codes in rows.items():
        apart = np.sum([test.of(code) for code in codes], axis=0)
        resolved = int((test.of_each_motion(apart) > BLIND_ERROR).sum())
        conditioning = np.quantile(test.conditioning(np.array(codes)), 0.1)
        figures = (
            f"{resolved} of {TEST_WALKS} | {np.median(apart):.3f} | {np.quantile(apart, 0.1):.3f}"
        )
        print(f"| {name} | {figures} | {conditioning:.3f} |", flush=True)
    for name, codes in rows.items():
        if name.startswith("designed"):
            print(
                name,
                *("".join(str(int(bit)) for bit in np.asarray(code)) for code in codes),
                flush=True,
            )


def blind() -> None:
    codes = {
        "open": np.ones(CHIPS),
        "first half": 1 - gray_planes(1, CHIPS)[0],
        "Gray": gray_planes(2, CHIPS)[1],
    }
    print("| photo | " + " | ".join(codes) + " |\n|---|" + "---:|" * len(codes))
    errors = []
    for number, (name, photo) in enumerate(photos(None)):
        sharp = photo.mean(axis=2) if photo.ndim == 3 else photo
        if min(sharp.shape) < 1.4 * SIDE_PX:
            continue
        walk = boracchi_foi(np.random.default_rng(100 + number), max_length_px=60.0)
        row = []
        for chips in codes.values():
            code = ShutterCode(chips)
            psf = coded_psf(walk, code)
            psf = psf / psf.sum()
            blurred = fftconvolve(sharp, psf, mode="valid")[:SIDE_PX, :SIDE_PX]
            noise = np.random.default_rng(number).normal(0, NOISE / code.duty, blurred.shape)
            row.append(
                _error(psf, PmpEstimator(crops=1).estimate(np.clip(blurred + noise, 0, 1)).psf)
            )
        errors += row
        print(f"| {name} | " + " | ".join(f"{error:.3f}" for error in row) + " |", flush=True)
    print(
        f"median {np.median(errors):.3f}, quartiles"
        f" {np.quantile(errors, [0.25, 0.75]).round(3).tolist()}"
    )


def _error(psf: FloatArray, kernel_estimate: FloatArray, grid_px: int = 240) -> float:
    """Energy of the difference within the band, the kernels aligned as they fit best."""
    f = np.fft.fftfreq(grid_px)
    band = np.hypot(f[:, None], f) <= BAND_CY_PX
    otfs = [
        np.fft.fft2(kernel / kernel.sum(), (grid_px, grid_px)) * band
        for kernel in (psf, kernel_estimate)
    ]
    alike = np.fft.ifft2(otfs[0] * otfs[1].conj()).real.max() * grid_px**2
    energy = [(np.abs(otf) ** 2).sum() for otf in otfs]
    return float((sum(energy) - 2 * alike) / energy[0])


STUDIES = {"separation": separation, "blind": blind}

if __name__ == "__main__":
    parser = study_parser(__doc__)
    parser.add_argument("study", choices=STUDIES, help="what is measured")
    STUDIES[parser.parse_args().study]()
