"""What the studies share: their help, photos (a folder, or scikit-image's own), and rows of
results, which outlive a run that ends early.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cep.files.images import read_image
from lab.jobs.fingerprint import source_version
from motdiff.crops import pick_crops
from motdiff.photo_values import luminance, to_linear
from motdiff.types import FloatArray

BUNDLED = ("camera", "astronaut", "coffee", "chelsea", "brick", "coins", "page", "moon")
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp"})

# -- photos ---------------------------------------------------------------------------------------


def photos(folder: Path | None) -> list[tuple[str, FloatArray]]:
    """Names and linear light of a folder's photos; of scikit-image's without one.

    Raises
    ------
    ValueError
        If the folder holds no photos, or one cannot be read.
    """
    if folder is None:
        from skimage import data

        return [(name, to_linear(getattr(data, name)() / 255.0)) for name in BUNDLED]
    return [(path.name, read_light(path)) for path in photo_files(folder)]


def photo_files(folder: Path) -> list[Path]:
    """Photos of a folder and its subfolders; ValueError without any."""
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in PICTURES)
    if not files:
        raise ValueError(f"{folder}: holds no photos ({', '.join(sorted(PICTURES))})")
    return files


def read_light(file: Path) -> FloatArray:
    """Linear light (H, W, 3) of a photo; ValueError where it cannot be read."""
    light = read_image(file)
    return light if light.ndim == 3 else np.repeat(light[..., None], 3, axis=2)


def large_scenes(
    scenes: Iterable[tuple[str, FloatArray]], *, least_px: int
) -> list[tuple[str, FloatArray]]:
    """Those whose sides have so many px at least; ValueError without any."""
    large = [(name, light) for name, light in scenes if min(light.shape[:2]) >= least_px]
    if not large:
        raise ValueError(f"photos: none has sides of {least_px} px or more")
    return large


@cache
def _grey_bundled() -> tuple[FloatArray, ...]:
    return tuple(luminance(light) for _, light in photos(None))


def textured_scene(folder: str, *, side_px: int, rng: np.random.Generator) -> FloatArray:
    """Grey scene of a photo of a folder, or of scikit-image where it is empty.

    The photo's most textured part, ``side_px`` wide, is in the middle of twice that size.
    """
    if folder:
        files = photo_files(Path(folder))
        grey = luminance(read_light(files[rng.integers(len(files))]))
    else:
        grey = _grey_bundled()[rng.integers(len(_grey_bundled()))]
    row, column = pick_crops(grey, size=side_px, count=1)[0]
    height, width = (min(side_px, n) for n in grey.shape)
    down, right = ((side_px - n, side_px) for n in (height, width))
    around = side_px // 2
    wide = np.pad(
        grey, [(around, around + down[0]), (around, around + right[0])], mode="symmetric"
    )
    return wide[row : row + 2 * side_px, column : column + 2 * side_px]


# -- rows of results ------------------------------------------------------------------------------


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


def case_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of the file that a run goes on with, each with its ``case``.

    A case holds all that its figures depend on: options, and the version of the estimator. Rows
    of other cases may be in the file. ValueError if a row does not say its case.
    """
    rows = finished_rows(file)
    if not all("case" in row for row in rows):
        raise ValueError(f"{file}: has rows that do not say by which options; name a new file")
    return rows


def finished_cases(file: Path | None) -> dict[str, dict[str, Any]]:
    """Figures of the finished :func:`case_rows`, by :func:`case_key`; none without a file."""
    return {case_key(row.pop("case")): row for row in case_rows(file)} if file else {}


def study_version(study: str) -> str:
    """Version of what a study's rows depend on: it, all that it imports, and the shipped weights.

    The files of photos and recordings count by their names alone.
    """
    # torch takes seconds, which --help does not need
    from cep.restoration.denoiser import network as denoiser
    from motdiff import weights

    shipped = (weights.DEFAULT_WEIGHTS, weights.CORRECTION_WEIGHTS, weights.PATH_WEIGHTS)
    files = (*shipped, denoiser.SHIPPED)
    return source_version([f"lab.studies.{study}"], files=files)


def case_key(case: Mapping[str, object]) -> str:
    """Key of a case: its options as JSON, whatever their order."""
    return json.dumps(case, sort_keys=True)


def check_version(rows: Iterable[Mapping[str, Any]]) -> None:
    """Refuse rows of several versions of an estimator: their means would say nothing.

    Rows of before versions were written, without a case, count as a version of their own.
    """
    versions = {row.get("case", {}).get("version") for row in rows}
    if len(versions) > 1:
        raise ValueError(f"rows: are of {len(versions)} versions of the estimator; compare files")


def add_row(file: Path, row: Mapping[str, Any]) -> None:
    """Append a row to a file of JSON lines, which :func:`kept_rows` reads."""
    cut_off = file.exists() and file.read_bytes()[-1:] not in (b"", b"\n")
    with file.open("a", encoding="utf-8") as stream:
        stream.write("\n" * cut_off + json.dumps(row) + "\n")


# -- command lines --------------------------------------------------------------------------------


def study_parser(documentation: str | None) -> argparse.ArgumentParser:
    """Parser of a study, whose help is the text at the top of its file."""
    return argparse.ArgumentParser(
        description=documentation, formatter_class=argparse.RawDescriptionHelpFormatter
    )


@contextmanager
def refusals(parser: argparse.ArgumentParser) -> Iterator[None]:
    """Print what is wrong with an input as one line, and end with exit code 2."""
    try:
        yield
    except (ValueError, OSError) as refusal:
        parser.error(str(refusal))
