"""Protocols of the coded-exposure table, as TOML files: photos, motions, codes, light,
restoration.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cep.optics.camera import Camera
from cep.restoration.registry import find_method
from cep.search.objectives import OBJECTIVES
from motdiff.files.inputs import one_line, read_toml
from motdiff.motions import boracchi_foi, quadratic, random_straight
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

PROTOCOLS = ("paper", "ours")
"""Built in."""

_MOST_PHOTONS = 1e9
_WHOLE = {  # least and most; the comparison leaves out 32 px at each border
    "photos": (1, 10_000),
    "motions": (1, 10_000),
    "crop_px": (80, 4096),
    "chips": (3, 4096),
    "bits": (1, 16),
    "steps": (1, 10**12),
    "border_rounds": (0, 1000),
    "seed": (0, 2**31),
    "quick_photos": (1, 10_000),
    "quick_motions": (1, 10_000),
    "quick_steps": (1, 10**12),
}
_ALLOWED = {
    "borders": ("real", "symmetric"),
    "shakes": ("boracchi-foi", "mixed"),
    "objective": tuple(OBJECTIVES),
    "restored_by": ("psf", "path", "estimate", "blind"),
}


@dataclass(frozen=True, kw_only=True)
class CodedProtocol:
    """A protocol of the coded-exposure table.

    Parameters
    ----------
    name : str
    photos, motions : int
        Photos, and motions each photo is taken with.
    crop_px : int
        Side of the photo, px.
    borders : {"real", "symmetric"}
        Whether light comes in from outside the photo, or the scene is mirrored at its borders.
    shakes : {"boracchi-foi", "mixed"}
        Random walks of 60 px; or those of 20 to 60 px, curved and straight motions in turn.
    chips : int
    open_range : (int, int)
        Fewest and most open chips.
    objective : str
        Of the search; see :mod:`cep.search.cost`.
    photons : tuple of float
        Photo-electrons at full scale of each light level, for which codes are searched anew.
        Empty: no noise but the quantisation, and each photo has the light of the open shutter:
        coding costs none.
    calibration_photons : float
        Light of the uncoded photo that motions are estimated from; without light levels it is as
        free of noise as the others.
    bits : int
        Of the quantisation.
    read_noise_e : float
    restoration : str
        One of :data:`cep.restoration.registry.METHODS`, or ``module:name`` of a function of the
        user's own that takes (photo, psf).
    border_rounds : int
        Rounds in which the restoration extends the photo beyond its borders. A blur of 60 px needs
        dozens. Passed to restorations that have this parameter.
    restored_by : {"psf", "path", "estimate", "blind"}
        Input of the restoration: the true coded PSF; the true path, of unknown direction; the path
        that the code was designed for, tried in both directions; or the kernel that PMP finds in
        the restored photo itself, as of a motion that never repeats.
    steps : int
        Moves of every search.
    seed : int
    quick_photos, quick_motions, quick_steps : int
    quick_photons : tuple of float
        Of ``--quick``; the same light levels when there are none.
    """

    name: str
    photos: int
    motions: int
    crop_px: int
    borders: Literal["real", "symmetric"]
    shakes: Literal["boracchi-foi", "mixed"]
    chips: int
    open_range: tuple[int, int]
    objective: str
    photons: tuple[float, ...]
    calibration_photons: float
    bits: int
    read_noise_e: float
    restoration: str
    border_rounds: int
    restored_by: Literal["psf", "path", "estimate", "blind"]
    steps: int
    seed: int
    quick_photos: int
    quick_motions: int
    quick_steps: int
    quick_photons: tuple[float, ...]

    def __post_init__(self) -> None:
        for name, (low, high) in _WHOLE.items():
            value = getattr(self, name)
            if type(value) is not int or not low <= value <= high:
                raise ValueError(
                    f"{name}: must be a whole number within {low}..{high}, got {value!r}"
                )
        for name, allowed in _ALLOWED.items():
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name}: must be one of {', '.join(allowed)}, got {getattr(self, name)!r}"
                )
        for name in ("name", "restoration"):
            if not (isinstance(text := getattr(self, name), str) and text):
                raise ValueError(f"{name}: must be a text that is not empty, got {text!r}")
        try:
            find_method(self.restoration)
        except ValueError as error:
            raise ValueError(f"restoration: {one_line(error).removeprefix('method: ')}") from None
        pair = self.open_range
        if not (_are(pair, int) and len(pair) == 2 and 1 <= pair[0] <= pair[1] <= self.chips):
            raise ValueError(
                f"open_range: must be two numbers of chips within 1..{self.chips} in order, got"
                f" {pair!r}"
            )
        for name in ("photons", "quick_photons"):
            levels = getattr(self, name)
            if not (
                _are(levels, int, float) and all(0 < level <= _MOST_PHOTONS for level in levels)
            ):
                raise ValueError(
                    f"{name}: must be a list of light levels above 0, up to 1e9, got {levels!r}"
                )
            if len(set(levels)) < len(levels):
                raise ValueError(f"{name}: every level must come once, got {levels!r}")
            object.__setattr__(self, name, tuple(float(level) for level in levels))
        for name, least_e, most_e in (
            ("calibration_photons", 1e-3, _MOST_PHOTONS),
            ("read_noise_e", 0.0, 1e4),
        ):
            value = getattr(self, name)
            if not (_are([value], int, float) and least_e <= value <= most_e):
                raise ValueError(
                    f"{name}: must be a number within {least_e:g}..{most_e:g}, got {value!r}"
                )
        object.__setattr__(self, "open_range", tuple(self.open_range))

    @property
    def quick(self) -> CodedProtocol:
        """The same with fewer photos, motions, moves and light levels."""
        return replace(
            self,
            photos=self.quick_photos,
            motions=self.quick_motions,
            steps=self.quick_steps,
            photons=self.quick_photons or self.photons,
        )

    @property
    def levels(self) -> tuple[float | None, ...]:
        """Light levels; the only one is None when only quantisation counts."""
        return self.photons or (None,)

    @property
    def calibration_camera(self) -> Camera:
        """Camera of the uncoded photo that a motion is estimated from."""
        return self.camera(self.calibration_photons if self.photons else None)

    def camera(self, photons: float | None) -> Camera:
        """Camera at a light level."""
        if photons is None:
            return Camera(photons_full_scale=_MOST_PHOTONS, read_noise_e=0.0, bits=self.bits)
        # a raw file's pedestal of 6 sigma: without it, clipped read noise would brighten the
        # darkest photos
        pedestal = min(0.5, 6 * self.read_noise_e / photons)
        return Camera(
            photons_full_scale=photons,
            read_noise_e=self.read_noise_e,
            bits=self.bits,
            black_level=pedestal,
        )


def coded_protocol(name: str, changes: Sequence[str] = ()) -> CodedProtocol:
    """Load a built-in protocol by name, or one's own by the path of its ``.toml`` file.

    Parameters
    ----------
    name : str
    changes : sequence of str
        Fields with other values, each as in a protocol's file: ``motions=20``,
        ``photons=[10000]``.

    Raises
    ------
    ValueError
        If there is no such protocol, or a field is missing, unknown or out of range.

    Examples
    --------
    >>> coded_protocol("ours", ["motions=20", "photons=[10000]"]).photons
    (10000.0,)
    """
    if name.endswith(".toml"):
        path = Path(name)
        if not path.exists():
            raise ValueError(
                f"{name}: no such file; built-in protocols are {', '.join(PROTOCOLS)}"
            )
    elif name in PROTOCOLS:
        path = Path(__file__).parent / f"{name}.toml"
    else:
        raise ValueError(
            f"protocol: must be one of {', '.join(PROTOCOLS)} or a .toml file, got {name[:40]!r}"
        )
    table = read_toml(path)
    field_names = {field.name for field in fields(CodedProtocol)}
    for what, names in (
        ("unknown", set(table) - field_names),
        ("missing", field_names - set(table)),
    ):
        if names:
            raise ValueError(
                f"{name}: field {min(names)[:40]!r} is {what}; the fields are"
                f" {', '.join(sorted(field_names))}"
            )
    for change in changes:
        table |= _change(change, field_names)
    try:
        return CodedProtocol(**table)
    except ValueError as error:
        raise ValueError(f"{name}: {one_line(error)}") from None


def _change(text: str, field_names: Collection[str]) -> dict[str, Any]:
    """Read a field and its value from a line of TOML; a bare word is a text."""
    field, _, value = (piece.strip() for piece in text.partition("="))
    if field not in field_names:
        raise ValueError(
            f"set: must be FIELD=VALUE with one of {', '.join(sorted(field_names))}, got"
            f" {text[:40]!r}"
        )
    try:
        read = {} if "\n" in value else tomllib.loads(f"{field} = {value}")
    except tomllib.TOMLDecodeError:
        read = {field: value} if value and set(value).isdisjoint("\"'[]{}=") else {}
    if not read:
        raise ValueError(
            f"set: {field} needs a number, a text or a list as [1, 2], got {value[:40]!r}"
        )
    return read


def _are(values: object, *kinds: type) -> bool:
    """Whether these are numbers of those types; TOML's true is none."""
    return isinstance(values, list | tuple) and all(type(value) in kinds for value in values)


def paths_to(paths: Sequence[Trajectory], weights: Sequence[float]) -> str:
    """Write weighted paths as one line of text, for a table's cell."""
    rows = [
        {
            "t": path.t.tolist(),
            "xy": path.xy.tolist(),
            "direction": path.direction,
            "weight": float(weight),
        }
        for path, weight in zip(paths, weights, strict=True)
    ]
    return json.dumps(rows)


def paths_from(text: str) -> tuple[tuple[Trajectory, ...], tuple[float, ...]]:
    """Read a text of :func:`paths_to`: paths and weights."""
    rows = json.loads(text)
    paths = tuple(
        Trajectory(np.array(row["t"]), np.array(row["xy"]), row["direction"]) for row in rows
    )
    return paths, tuple(float(row["weight"]) for row in rows)


_MIXED_LENGTHS_PX = (20.0, 60.0)


def drawn_motions(protocol: CodedProtocol, *, stream: int = 0) -> tuple[Trajectory, ...]:
    """Draw the protocol's motions; only the oracle uses their direction. Each stream of random
    numbers has others.
    """
    rng = np.random.default_rng([protocol.seed, stream])
    if protocol.shakes == "boracchi-foi":
        return tuple(boracchi_foi(rng) for _ in range(protocol.motions))
    low, high = _MIXED_LENGTHS_PX
    draw: tuple[Callable[[], Trajectory], ...] = (
        lambda: boracchi_foi(rng, max_length_px=float(rng.uniform(low, high))),
        lambda: quadratic(rng, min_length_px=low, max_length_px=high),
        lambda: random_straight(rng, min_length_px=low, max_length_px=high),
    )
    return tuple(_fitting(draw[index % len(draw)]) for index in range(protocol.motions))


_CLASS = 60  # motions of a class: docs/decisions/search.md
_TOLERANCE_PX = 0.01


def class_motions(protocol: CodedProtocol) -> tuple[Trajectory, ...]:
    """Draw other motions of the protocol's kind, from a seed of their own, for codes that know
    nothing but the kind.
    """
    motions = drawn_motions(replace(protocol, motions=_CLASS), stream=6)
    return tuple(path.thinned(_TOLERANCE_PX) for path in motions)


def _fitting(draw: Callable[[], Trajectory]) -> Trajectory:
    # a motion that speeds up lies off-centre: the longest of them leave the frame
    while (path := draw()).frame_size() > PSF_PX:
        pass
    return path
