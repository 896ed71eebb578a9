"""What the studies share: their help, photos (a folder, or scikit-image's own), a gyroscope trace,
and rows of results, which outlive a run that ends early.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lab.bench.blind.protocol import synthetic_trace
from motdiff.gyro import GyroTrace
from motdiff.photo_values import to_linear
from motdiff.types import FloatArray

BUNDLED = ("camera", "astronaut", "coffee", "chelsea", "brick", "coins", "page", "moon")


def photos(folder: Path | None) -> list[tuple[str, FloatArray]]:
    import cv2

    if folder is None:
        from skimage import data

        return [(name, to_linear(getattr(data, name)() / 255.0)) for name in BUNDLED]
    images = [(p.name, cv2.imread(str(p), cv2.IMREAD_COLOR)) for p in photo_files(folder)]
    return [
        (name, to_linear(image[..., ::-1] / 255.0)) for name, image in images if image is not None
    ]


def photo_files(folder: Path) -> list[Path]:
    suffixes = {".png", ".jpg", ".jpeg", ".tif", ".bmp"}
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes)


def smooth_trace(rng: np.random.Generator, *, duration_s: float, rate_hz: float) -> GyroTrace:
    """Synthetic hand shake, for studies without a recording."""
    return synthetic_trace(rng, duration_s=duration_s, rate_hz=rate_hz)


def kept_rows(file: Path) -> Iterator[dict[str, Any]]:
    """Rows of a file of JSON lines; a line that was cut short when a run ended is left out."""
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        yield row


def finished_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of the file that a run goes on with; none where it is new."""
    return list(kept_rows(file)) if file.exists() else []


def finished_cases(file: Path | None) -> dict[str, dict[str, Any]]:
    """Figures of the finished cases, by :func:`case_key`; none without a file."""
    return {case_key(row.pop("case")): row for row in finished_rows(file)} if file else {}


def case_key(case: object) -> str:
    return json.dumps(case, sort_keys=True)


def add_row(file: Path, row: Mapping[str, Any]) -> None:
    """Append a row to a file of JSON lines, which :func:`kept_rows` reads."""
    cut_off = file.exists() and file.read_bytes()[-1:] not in (b"", b"\n")
    with file.open("a", encoding="utf-8") as stream:
        stream.write("\n" * cut_off + json.dumps(row) + "\n")


def study_parser(documentation: str | None) -> argparse.ArgumentParser:
    """Parser of a study, whose help is the text at the top of its file."""
    return argparse.ArgumentParser(
        description=documentation, formatter_class=argparse.RawDescriptionHelpFormatter
    )
