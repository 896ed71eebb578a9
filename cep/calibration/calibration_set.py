"""Codes for several photos of one motion, which show its order in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.order_codes import allowed_limits, search_next, tells_no_direction
from cep.calibration.order_contrast import ALIKE_PX, ORDER_KNOTS, TOLD, OrderContrast
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.search.limits import nearest
from cep.search.sampling import draw
from hw.device import DeviceProfile
from hw.export import export_program, find_exporter
from hw.program import Program
from motdiff.estimators.coded.starts import orders
from motdiff.files.inputs import one_line
from motdiff.files.json_files import fault, json_text, load_schema, read_versioned
from motdiff.files.outputs import new_folder, write_text
from motdiff.metrics import rms_distance_px
from motdiff.motions import boracchi_foi
from motdiff.types import FloatArray

_FILE = "set.json"
_SCHEMA = "cep.calibration-set/2"

_LENGTH_PX = 60.0  # walks that long have 8 orders in the median: enough for a set to fail on
_DESIGN_WALKS = 32
_TEST_WALKS = 64  # others than those of the design, which its codes fit too well
_DRAWN = 64
_MOST_ORDERS = 6  # of a walk, beside its own
_LEAST_CHIPS = 4
_MOST_CHIPS = 512  # the walks' slices take 0.8 MB a chip
_LEAST_PHOTOS = 2
_MOST_PHOTOS = 8
_RIGHT = {2: (17, 24)}
"""By number of photos: shakes and tangled walks, simulated on photographs, whose path was found
within 1 px, in order, and all of them (docs/decisions/motion-estimation.md)."""


@dataclass(frozen=True)
class Contrast:
    """How well a set tells orders in time, on simulated walks other than those it was designed on.

    Attributes
    ----------
    walks : int
    length_px : float, px
    walks_told : int
        Walks of which the photos rule out each other order, six at most.
    median, worst_tenth : float
        Over all other orders: chi-square between them and the walk's, as of
        :class:`cep.calibration.order_contrast.OrderContrast`.
    """

    walks: int
    length_px: float
    walks_told: int
    median: float
    worst_tenth: float

    @classmethod
    def of(cls, contrast: OrderContrast) -> Contrast:
        """Measure it by the photos taken, of :func:`contrast_of_walks`."""
        chi_squares = contrast.taken()
        walk_starts = np.flatnonzero(np.diff(contrast.pairs[0], prepend=-1))
        least_chi_squares = np.minimum.reduceat(chi_squares, walk_starts)
        return cls(
            walks=len(walk_starts),
            length_px=_LENGTH_PX,
            walks_told=int((least_chi_squares > TOLD).sum()),
            median=float(np.median(chi_squares)),
            worst_tenth=float(np.quantile(chi_squares, 0.1)),
        )


@dataclass(frozen=True)
class CalibrationSet:
    """Codes for photos of one motion, in the order of the photos.

    Attributes
    ----------
    codes : tuple of ShutterCode
    contrast : Contrast
    device : DeviceProfile or None
        That can play them.
    """

    codes: tuple[ShutterCode, ...]
    contrast: Contrast
    device: DeviceProfile | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """What each code is called: ``open``, or the name of its file."""
        return tuple(
            "open" if code.open_chips == code.chips else f"code_{i}.json"
            for i, code in enumerate(self.codes, 1)
        )

    @property
    def summary(self) -> str:
        """What to do, and how often that tells the order."""
        count = len(self.codes)
        steps = ", ".join(
            f"P{i} {'with the shutter open' if name == 'open' else f'through {name}'}"
            for i, name in enumerate(self.sources, 1)
        )
        measured = ""
        if count in _RIGHT:
            right, motions = _RIGHT[count]
            measured = (
                f" So many photos, of 52 chips, told the order of {right} of {motions} motions,"
                " simulated on photographs."
            )
        return f"Take {count} photos of the motion, {steps}.{measured}"

    def command(self, folder: Path | str) -> str:
        """Return the command that finds the motion from photos P1, P2, ... and the set."""
        photos = " ".join(f"P{i}" for i in range(1, len(self.codes) + 1))
        codes = " ".join(
            f"--code {name if name == 'open' else quote(str(Path(folder) / name))}"
            for name in self.sources
        )
        return f"cep calibrate {photos} {codes} -o motion"

    def to_dict(self, folder: Path | str) -> dict[str, Any]:
        """Fields for JSON, as of a set in ``folder``."""
        return {
            "summary": self.summary,
            "photos": [
                {
                    "photo": f"P{i}",
                    "code": name,
                    "bits": code.bits,
                    "open": code.open_chips,
                    "pulses": code.pulses,
                }
                for i, (name, code) in enumerate(zip(self.sources, self.codes, strict=True), 1)
            ],
            "command": self.command(folder),
            "chips": self.codes[0].chips,
            "chip_ns": self.codes[0].chip_ns,
            "device": self.device and self.device.name,
            "contrast": self.contrast,
        }

    def save(
        self, folder: Path | str, *, file_format: str = "csv", force: bool = False
    ) -> list[Path]:
        """Write ``set.json``, and each code as ``code.json`` and as a timed program, or nothing.

        Parameters
        ----------
        folder : folder, made when missing
        file_format : str
            A name of :data:`hw.export.EXPORTERS`.
        force : bool
            Whether existing files may be replaced.

        Returns
        -------
        list of Path
        """
        names = set_files(len(self.codes), file_format)
        with new_folder(folder, names, force=force) as staged:
            write_text(staged / _FILE, json_text({"schema": _SCHEMA, **self.to_dict(folder)}))
            device = self.device and self.device.to_dict()
            all_bits = [code.bits for code in self.codes]
            for i, code in enumerate(self.codes, 1):
                about = {"calibration_set": all_bits, "photo": i, "device": device}
                write_code(staged / f"code_{i}.json", StoredCode(code, problem=about))
                program = Program(code.bits, chip_ns=code.chip_ns)
                write_text(
                    staged / find_exporter(file_format).file_name(f"code_{i}"),
                    export_program(program, file_format, device=self.device),
                )
        return [Path(folder) / name for name in names]


def set_files(photos: int, file_format: str) -> tuple[str, ...]:
    """Names of the files of a set."""
    stems = [f"code_{i}" for i in range(1, photos + 1)]
    return (
        _FILE,
        *(f"{stem}.json" for stem in stems),
        *(find_exporter(file_format).file_name(stem) for stem in stems),
    )


def read_set(folder: Path | str, *, chip_ns: int | None = None) -> list[ShutterCode]:
    """Read the codes of a set that :meth:`CalibrationSet.save` wrote, in the order of the photos.

    Parameters
    ----------
    folder : folder
    chip_ns : int, optional
        Their chip time; the set's when omitted.

    Raises
    ------
    ValueError
        If the set's file is not valid; the line names it.
    OSError
        If it cannot be read.
    """
    source = Path(folder) / _FILE
    document = read_versioned(source, _SCHEMA)
    if (wrong := fault(document, load_schema("cep.files", "calibration-set"))) is not None:
        raise ValueError(f"{source}: {wrong}")
    chip_ns = chip_ns or int(document["chip_ns"])
    try:
        return [ShutterCode(photo["bits"], chip_ns) for photo in document["photos"]]
    except ValueError as error:
        raise ValueError(f"{source}: {one_line(error)}") from None


def calibration_set(
    photos: int,
    *,
    chips: int,
    chip_ns: int = 1_000_000,
    device: DeviceProfile | str | None = None,
    rng: np.random.Generator,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> CalibrationSet:
    """Design the codes of photos of one motion, for the "coded" method of calibration.

    Parameters
    ----------
    photos : int
        2 to 8: in one alone the scene hides the order.
    chips : int
        4 to 512.
    chip_ns : int
    device : DeviceProfile or str, optional
        That can play every code, or its name as of :func:`hw.device.load_profile`.
    rng : numpy Generator
        Of the simulated walks and of codes to begin with.
    progress : callable
        Called with the finished share 0..1 and a note.

    Raises
    ------
    ValueError
        If a number is out of range, or the device cannot play such codes.

    Examples
    --------
    >>> codes = calibration_set(2, chips=8, device="flc", rng=np.random.default_rng(0)).codes
    >>> len(codes), codes[0].chips
    (2, 8)
    """
    if not _LEAST_PHOTOS <= photos <= _MOST_PHOTOS:
        raise ValueError(f"photos: must be {_LEAST_PHOTOS} to {_MOST_PHOTOS}, got {photos}")
    if not _LEAST_CHIPS <= chips <= _MOST_CHIPS:
        raise ValueError(f"chips: must be {_LEAST_CHIPS} to {_MOST_CHIPS}, got {chips}")
    limits, device = allowed_limits(chips, chip_ns, device)
    progress(0.0, "simulating walks")
    # the open shutter fixes the path, of which only the order is left to tell
    first = nearest(limits, np.ones(chips, dtype=np.int8))
    if first is None:  # too many chips and openings to be sought among all codes
        first = max(draw(limits, _DRAWN, rng=rng), key=np.sum)
    design, test = (
        contrast_of_walks(ordered_walks(count, rng=rng), first, chips=chips)
        for count in (_DESIGN_WALKS, _TEST_WALKS)
    )
    codes = [first]

    def tick(share: float) -> None:
        searched = (len(codes) - 1 + share) / (photos - 1)
        progress(0.1 + 0.85 * searched, "searching codes")

    while len(codes) < photos:
        code, _ = search_next(design, limits, score=_harmonic_mean, rng=rng, progress=tick)
        codes.append(code)
        design = design.after(code)
        test = test.after(code)
    if tells_no_direction(codes):
        raise ValueError(
            f"chips: every code of {chips} chips within the limits is its own mirror image, which"
            " tells no direction; more or shorter chips would do"
        )
    progress(0.95, "measuring")
    return CalibrationSet(
        tuple(ShutterCode(code, chip_ns) for code in codes), Contrast.of(test), device
    )


def _harmonic_mean(chi_squares: FloatArray) -> FloatArray:
    """Mean (C,) in which orders hard to tell count most, but no hopeless walk alone."""
    return np.asarray(1 / (1 / (chi_squares + TOLD)).mean(axis=1))


def contrast_of_walks(
    walks: Sequence[FloatArray], code: ArrayLike, *, chips: int
) -> OrderContrast:
    """Contrast of each walk's first order with its others, after a photo through a code."""
    counts = np.array([len(walk) for walk in walks])
    starts = np.cumsum(counts) - counts
    altered = np.setdiff1d(np.arange(counts.sum()), starts)
    pairs = np.stack([np.repeat(starts, counts - 1), altered])
    return OrderContrast(np.concatenate(walks), [code], chips=chips, pairs=pairs)


def ordered_walks(count: int, *, rng: np.random.Generator) -> list[FloatArray]:
    """Draw walks (N, 53, 2), px: a walk, its reverse and up to five other orders of its loops."""
    walks = []
    for _ in range(count):
        walk = orders(boracchi_foi(rng, max_length_px=_LENGTH_PX), knots=ORDER_KNOTS, count=64)
        altered = [k for k in range(2, len(walk)) if rms_distance_px(walk[k], walk[0]) >= ALIKE_PX]
        chosen = rng.permutation(altered)[: _MOST_ORDERS - 1]
        walks.append(walk[[0, 1, *chosen]])
    return walks
