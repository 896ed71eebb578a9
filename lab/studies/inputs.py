"""What the benchmarks share: photos (a folder, or scikit-image's own), a gyroscope trace, results
of an ended run.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from motdiff.gyro import GyroTrace
from motdiff.simulate import to_linear
from motdiff.types import FloatArray

BUNDLED = ("camera", "astronaut", "coffee", "chelsea", "brick", "coins", "page", "moon")


def photos(folder: Path | None) -> list[tuple[str, FloatArray]]:
    import cv2

    if folder is None:
        from skimage import data

        return [(name, to_linear(getattr(data, name)() / 255.0)) for name in BUNDLED]
    paths = sorted(
        p
        for p in folder.rglob("*")
        if p.suffix.lower() in {".png", ".jpg", ".jpeg", ".tif", ".bmp"}
    )
    images = [(p.name, cv2.imread(str(p), cv2.IMREAD_COLOR)) for p in paths]
    return [
        (name, to_linear(image[..., ::-1] / 255.0)) for name, image in images if image is not None
    ]


def smooth_trace(rng: np.random.Generator, *, duration_s: float, rate_hz: float) -> GyroTrace:
    """Hand-like angular rates: band-limited noise, 1 to 12 Hz, about 0.1 rad/s."""
    count = round(duration_s * rate_hz)
    freq_hz = np.fft.rfftfreq(count, 1 / rate_hz)
    spectrum = rng.standard_normal((2, 3, freq_hz.size)) * np.exp(-freq_hz / 4) * (freq_hz > 0.5)
    rate = np.fft.irfft(spectrum[0] + 1j * spectrum[1], count, axis=1).T
    return GyroTrace(np.arange(count) / rate_hz, 0.1 * rate / rate.std(axis=0))


def kept_rows(file: Path) -> Iterator[dict[str, Any]]:
    """Rows of a file of JSON lines; a line that was cut short when a run ended is left out."""
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        yield row
