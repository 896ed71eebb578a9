"""Codes for several photos of one motion, which show its order in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from cep.calibration.order_codes import allowed_limits, search_order_codes
from cep.calibration.order_separation import BLIND_ERROR, OrderSeparation, ordered_walks
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from hw.device import DeviceProfile
from hw.export import export_program, find_exporter
from hw.program import Program
from motdiff.files.inputs import one_line
from motdiff.files.json_files import fault, json_text, load_schema, read_versioned
from motdiff.files.outputs import new_folder, write_text

_FILE = "set.json"
_SCHEMA = "cep.calibration-set/1"

_LENGTH_PX = 60.0  # walks that long have 8 orders in the median: enough for a set to fail on
_DESIGN_WALKS = 64
_TEST_WALKS = 64  # others than those of the design, which its codes fit too well
_LEAST_CHIPS = 4
_MOST_CHIPS = 512  # the walks' slices take 0.6 MB a chip
_MOST_PHOTOS = 8

_RIGHT = {1: (3, 39), 2: (22, 51), 3: (8, 12), 4: (36, 39)}
"""By number of photos: simulated walks of 60 px whose path was found within 1 px, in order, and
all of them (docs/decisions/motion-estimation.md and benchmarks.md)."""


@dataclass(frozen=True)
class Separation:
    """How well a set tells orders in time, on simulated walks other than those it was designed on.

    Attributes
    ----------
    walks : int
    length_px : float, px
    resolved : int
        Walks of which each other order, six at most, changes the photos by more than a blind
        search errs.
    median, worst_tenth : float
        Over all other orders: energy of the change of the photos' PSFs over that of the open
        shutter's PSF.
    conditioning : float
        Smallest rms MTF of the codes below :data:`cep.calibration.order_separation.BAND_CY_PX`; a
        tenth of the walks have less.
    """

    walks: int
    length_px: float
    resolved: int
    median: float
    worst_tenth: float
    conditioning: float


@dataclass(frozen=True)
class CalibrationSet:
    """Codes for photos of one motion, in the order of the photos.

    Attributes
    ----------
    codes : tuple of ShutterCode
    separation : Separation
    device : DeviceProfile or None
        That can play them.
    """

    codes: tuple[ShutterCode, ...]
    separation: Separation
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
        """What to do, how often it was enough, and what the set resolves."""
        separation = self.separation
        count = len(self.codes)
        steps = ", ".join(
            f"P{i} {'with the shutter open' if name == 'open' else f'through {name}'}"
            for i, name in enumerate(self.sources, 1)
        )
        resolved = (
            f"In {separation.resolved} of {separation.walks} simulated walks of"
            f" {separation.length_px:g} px each other order in time that was tried, six at most,"
            " changes the photos by more than a blind search errs."
        )
        measured = ""
        if count in _RIGHT:
            right, walks = _RIGHT[count]
            measured = f" So many photos told the order of {right} of {walks} simulated walks."
        return (
            f"Take {count} {'photo' if count == 1 else 'photos'} of the motion, {steps}.{measured}"
            f" {resolved}"
        )

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
            "separation": self.separation,
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
        1 to 8.
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
    if not 1 <= photos <= _MOST_PHOTOS:
        raise ValueError(f"photos: must be 1 to {_MOST_PHOTOS}, got {photos}")
    if not _LEAST_CHIPS <= chips <= _MOST_CHIPS:
        raise ValueError(f"chips: must be {_LEAST_CHIPS} to {_MOST_CHIPS}, got {chips}")
    limits, device = allowed_limits(chips, chip_ns, device)
    progress(0.0, "simulating walks")
    design, test = (
        OrderSeparation(ordered_walks(count, length_px=_LENGTH_PX, rng=rng), chips=chips)
        for count in (_DESIGN_WALKS, _TEST_WALKS)
    )
    progress(0.2, "searching codes")
    codes = search_order_codes(
        limits,
        photos,
        measure=design,
        rng=rng,
        progress=lambda share: progress(0.2 + 0.7 * share, "searching codes"),
    )
    progress(0.9, "measuring")
    # squared errors add up over photos
    separations = np.sum([test.of(code) for code in codes], axis=0)
    return CalibrationSet(
        tuple(ShutterCode(code, chip_ns) for code in codes),
        Separation(
            walks=_TEST_WALKS,
            length_px=_LENGTH_PX,
            resolved=int((test.of_each_motion(separations) > BLIND_ERROR).sum()),
            median=float(np.median(separations)),
            worst_tenth=float(np.quantile(separations, 0.1)),
            # a tenth of the walks is worse: the least of 64 would be an accident
            conditioning=float(np.quantile(test.conditioning(np.stack(codes)), 0.1)),
        ),
        device,
    )
