"""State of the page as the server reads it: checked field by field, then as a problem, as documents and as commands."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np

import cep
from cep.io.formatting import seconds_of
from cep.workflows.catalogue import example_motion
from cep.workflows.shutter import shutter_profile

__all__ = ["MOST_CHIPS", "FieldError", "Setting", "disk_error", "path_fields", "read_setting"]

MOST_CHIPS = 512
_MOST_SAMPLES = 512  # of a path in the address
_TIME_STEPS = 65_535  # of a path in the address: 16 bits
_FARTHEST_PX = 2_000.0
_MOST_ERROR_PX = 20.0
_LIMITS = ("min_open", "min_closed", "max_open", "max_pulses")
_FIELD_OF = {
    "bits": "bits",
    "camera": "camera",
    "chip_ns": "exposure",
    "chips": "bits",
    "code": "bits",
    "device": "device",
    "exposure": "exposure",
    "exposure_s": "exposure",
    "open_range": "open",
    "photons": "photons",
    "photons_full_scale": "photons",
    "read_noise_e": "read_noise",
    "scenarios": "motion",
    "trajectory": "motion",
}
"""Fields of the page that set what an error of the library begins with."""


class FieldError(ValueError):
    """Wrong input, and the field of the page beside which it is shown.

    Attributes
    ----------
    field : str
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(message)
        self.field = field

    @classmethod
    def of(cls, error: ValueError, *, fallback: str = "page") -> FieldError:
        """Return the error of a field that an error of the library names in its first words."""
        if isinstance(error, cls):
            return error
        head, colon, rest = str(error).partition(": ")
        first = head.split(" ")[0].rstrip(",")
        if first in _LIMITS:
            return cls(first, str(error))
        if first in _FIELD_OF:
            return cls(_FIELD_OF[first], rest if colon and " " not in head else str(error))
        return cls(fallback, str(error))


def disk_error(field: str, error: OSError) -> FieldError:
    """Return what to say beside a field where the studio's own folder cannot be written."""
    reason = (error.strerror or str(error)).lower()
    return FieldError(
        field, f"the studio's folder cannot be written ({reason}); free space there, or set TMPDIR and start it again"
    )


@dataclass(frozen=True)
class Setting:
    """What the page is set to.

    Attributes
    ----------
    motion : mapping
        ``kind`` "straight" with ``length`` px and ``angle`` degrees, "example" with ``name``, or "path" with ``t``,
        ``x``, ``y`` and ``direction``.
    trajectory : Trajectory
        The motion.
    bits : str
        The code.
    path_error : float or None
        Error of the motion, px rms over time, where it is an estimate.
    exposure : str
        As ``--exposure`` takes it.
    camera : str
        Name of a known camera; the standard one when empty.
    photons, read_noise : float or None
        Instead of the camera's.
    device : str
        Name of a shutter's profile; the camera's own shutter when empty.
    open_range : (int, int) or None
    limits : mapping
        Of :class:`cep.RunLimits`, those that are given.
    """

    motion: Mapping[str, Any]
    trajectory: cep.Trajectory
    bits: str
    path_error: float | None
    exposure: str
    camera: str
    photons: float | None
    read_noise: float | None
    device: str
    open_range: tuple[int, int] | None
    limits: Mapping[str, Any]

    @property
    def chips(self) -> int:
        """Number of chips."""
        return len(self.bits)

    @property
    def path_error_px(self) -> float:
        """Error of the motion, px rms over time: 0 where it is known."""
        return self.path_error or 0.0

    @property
    def key(self) -> str:
        """Text that differs where anything but the bits and the path's error differs, the number of bits included."""
        light = (self.camera, self.photons, self.read_noise)
        limits = (self.device, self.open_range, sorted(self.limits.items()))
        return repr((self.chips, self.motion, self.exposure, light, limits))

    @cached_property
    def sensor(self) -> cep.Camera:
        """Camera at its light.

        Raises
        ------
        FieldError
        """
        try:
            found = _camera(self.camera) if self.camera else cep.Camera()
            found = found if self.photons is None else found.at(self.photons)
            return found if self.read_noise is None else replace(found, read_noise_e=self.read_noise)
        except ValueError as error:
            raise FieldError.of(error, fallback="camera") from None

    @cached_property
    def profile(self) -> cep.DeviceProfile | None:
        """Shutter.

        Raises
        ------
        FieldError
        """
        try:
            return _profile(self.device) if self.device else None
        except ValueError as error:
            raise FieldError("device", str(error)) from None

    def problem(self, *, limited: bool = True) -> cep.SearchProblem:
        """Return the search problem; without its limits where the codes are only to be measured.

        Raises
        ------
        FieldError
        """
        try:
            return cep.SearchProblem.along(
                self.trajectory,
                chips=self.chips,
                exposure_s=seconds_of(self.exposure),
                camera=self.sensor if limited else replace(self.sensor, least_exposure_s=0.0),
                objective="mse",
                device=self.profile if limited else None,
                open_range=self.open_range if limited else None,
                runs=replace(cep.RunLimits(), **(self.limits if limited else {})),
            )
        except ValueError as error:
            if self.profile is not None and self.profile.name in str(error):
                raise FieldError("device", str(error).split(": ", 1)[-1]) from None
            raise FieldError.of(error, fallback="device" if self.device else "open") from None

    def code(self, bits: str | None = None) -> cep.ShutterCode:
        """Return the page's code, or another one, at the page's chip time."""
        chip_ns = self.problem(limited=False).chip_ns
        if self.profile is not None:
            with suppress(FieldError):  # a device that cannot play such codes: they last as they would without it
                chip_ns = self.problem().chip_ns
        return cep.ShutterCode(self.bits if bits is None else bits, chip_ns)

    # -- what reproduces it ---------------------------------------------------------------------------------------

    @property
    def motion_options(self) -> list[str]:
        """Options of the command line that name the motion."""
        if self.motion["kind"] == "straight" and not self.motion["angle"] and not self.path_error_px:
            return ["--linear", f"{self.motion['length']:g}"]
        return ["--trajectory", "trajectory.json"]

    @property
    def camera_options(self) -> list[str]:
        """Options of the command line that name the camera and the light."""
        given = {"--camera": self.camera or None, "--photons": self.photons, "--read-noise": self.read_noise}
        return [
            word
            for name, value in given.items()
            if value is not None
            for word in (name, value if isinstance(value, str) else f"{value:g}")
        ]

    @property
    def device_options(self) -> list[str]:
        """Option of the command line that names the shutter."""
        return ["--device", self.device] if self.device else []

    @property
    def limit_options(self) -> list[str]:
        """Options of the command line for the limits of the code."""
        words = [] if self.open_range is None else ["--open", "{}:{}".format(*self.open_range)]
        for name, value in self.limits.items():
            words += [f"--{name.replace('_', '-')}", str(value)]
        return words

    def commands(self, *, steps: int | None = None, seed: int = 0) -> list[str]:
        """Return the command lines that give what the page shows, in a folder with its trajectory.json and code.json.

        Parameters
        ----------
        steps : int, optional
            Moves of a search that found the code.
        seed : int
        """
        motion, time = self.motion_options, ["--exposure", self.exposure]
        light, device = self.camera_options, self.device_options
        lines = [
            ["cep", "mtf", *motion, "--code", "code.json", "-o", "mtf.png"],
            ["cep", "audit", "code.json", *motion],
        ]
        if self.chips > 1:
            lines.insert(0, ["cep", "advise", *motion, "--code", "code.json", *light, *device, "-o", "advice.png"])
        if steps is not None:
            search = ["--chips", str(self.chips), *time, *self.limit_options, *device, *light]
            ends = ["--steps", str(steps), "--seed", str(seed), "-o", "searched.json"]
            lines.insert(0, ["cep", "optimize", *motion, *search, *ends])
        return [shlex.join(line) for line in lines]


@lru_cache(maxsize=32)
def _camera(name: str) -> cep.Camera:
    return cep.Camera.load(name)


@lru_cache(maxsize=32)
def _profile(name: str) -> cep.DeviceProfile:
    return shutter_profile(name)


def read_setting(document: object) -> Setting:
    """Read the state that the page sends.

    Raises
    ------
    FieldError
        If a field is missing or malformed; the line says what would be right.
    """
    if not isinstance(document, dict):
        raise FieldError("page", f"the state must be an object, got {type(document).__name__}")
    bits = document.get("bits")
    if not isinstance(bits, str) or not bits or set(bits) - {"0", "1"}:
        raise FieldError("bits", "a code is a row of 1 (open) and 0 (closed), as 11010001")
    if len(bits) > MOST_CHIPS:
        raise FieldError("bits", f"the studio takes codes of up to {MOST_CHIPS} chips, this one has {len(bits)}")
    if "1" not in bits:
        raise FieldError("bits", "all chips are closed; at least one must be open")
    motion, trajectory = _motion(document.get("motion"))
    exposure = document.get("exposure", "50ms")
    if not isinstance(exposure, str) or len(exposure) > 20:
        raise FieldError("exposure", "the exposure is a time as 1/30, 20ms or 500us")
    try:
        seconds_of(exposure)
    except ValueError as error:
        raise FieldError.of(error) from None
    return Setting(
        motion=motion,
        trajectory=trajectory,
        bits=bits,
        path_error=_number(document, "path_error", 0.0, _MOST_ERROR_PX, "px"),
        exposure=exposure,
        camera=_name(document, "camera"),
        photons=_number(document, "photons", 1.0, 1e7, "photo-electrons at full scale"),
        read_noise=_number(document, "read_noise", 0.0, 1e5, "electrons of read noise"),
        device=_name(document, "device"),
        open_range=_open_range(document.get("open"), len(bits)),
        limits={name: value for name in _LIMITS if (value := _count(document, name)) is not None},
    )


def path_fields(trajectory: cep.Trajectory, *, most: int = 160) -> dict[str, Any]:
    """Return a motion as the page keeps it in its address: thinned to at most so many samples, times in 16 bits.

    Samples of a fast jump that fall on the same time are moved to the next ones.
    """
    path, tolerance_px = trajectory, 0.005
    while path.t.size > most:
        path, tolerance_px = trajectory.thinned(tolerance_px), 1.4 * tolerance_px
    order = np.arange(path.t.size)
    steps = np.maximum.accumulate(np.rint(_TIME_STEPS * path.t) - order) + order
    t = np.minimum(steps, _TIME_STEPS - order[::-1]) / _TIME_STEPS
    samples = {name: np.round(values, 5).tolist() for name, values in (("x", path.x), ("y", path.y))}
    return {"kind": "path", "direction": path.direction, "t": t.tolist(), **samples}


def _motion(given: object) -> tuple[Mapping[str, Any], cep.Trajectory]:
    if not isinstance(given, dict):
        raise FieldError("motion", "the motion must be an object with its kind")
    kind = given.get("kind")
    if kind == "straight":
        length = _number(given, "length", 1.0, 1_000.0, "px")
        angle = _number(given, "angle", -360.0, 360.0, "degrees") or 0.0
        if length is None:
            raise FieldError("length", "a straight motion needs its length in px")
        return {"kind": kind, "length": length, "angle": angle}, cep.Trajectory.straight(
            length, angle_rad=math.radians(angle)
        )
    if kind == "example":
        name = given.get("name")
        try:
            return {"kind": kind, "name": name}, example_motion(str(name))
        except ValueError as error:
            raise FieldError("motion", str(error)) from None
    if kind != "path":
        raise FieldError("motion", "the kind of a motion is straight, example or path")
    columns = [given.get(name) for name in "txy"]
    sizes = {len(column) if isinstance(column, list) else -1 for column in columns}
    if len(sizes) != 1 or not 2 <= sizes.pop() <= _MOST_SAMPLES:
        raise FieldError("motion", f"a path has 2 to {_MOST_SAMPLES} samples, as many of t as of x and y")
    if not all(_is_number(value) for column in columns for value in column or ()):
        raise FieldError("motion", "t, x and y of a path are finite numbers")
    t, x, y = (np.array(column, dtype=np.float64) for column in columns)
    if max(np.abs(x).max(), np.abs(y).max()) > _FARTHEST_PX:
        raise FieldError("motion", f"a path lies within {_FARTHEST_PX:g} px")
    direction: Literal["known", "unknown"] = "known" if given.get("direction") == "known" else "unknown"
    try:
        path = cep.Trajectory.from_samples(np.column_stack([x, y]), t=t, direction=direction)
    except ValueError as error:
        raise FieldError("motion", str(error).removeprefix("trajectory: ")) from None
    if path.extent_px < 1e-3:
        raise FieldError("motion", "the path stays in place; a motion is needed")
    return {"kind": kind, "t": t.tolist(), "x": x.tolist(), "y": y.tolist(), "direction": direction}, path


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(document: Mapping[str, Any], name: str, low: float, high: float, unit: str) -> float | None:
    value = document.get(name)
    if value is None or value == "":
        return None
    if not _is_number(value) or not low <= value <= high:
        raise FieldError(name, f"must be a number within {low:,.10g} to {high:,.10g} {unit}")
    return float(value)


def _count(document: Mapping[str, Any], name: str) -> int | None:
    value = _number(document, name, 1, MOST_CHIPS, "chips" if name != "max_pulses" else "openings")
    if value is None:
        return None
    if value != int(value):
        raise FieldError(name, "must be a whole number")
    return int(value)


def _name(document: Mapping[str, Any], field: str) -> str:
    """Return a name out of a list that the server gave; nothing that could be a file's."""
    value = document.get(field, "")
    if value is None or value == "":
        return ""
    plain = isinstance(value, str) and len(value) <= 64 and all(c.isalnum() or c in "-." for c in value)
    if not plain or value.endswith((".json", ".toml")):
        raise FieldError(field, "must be one of the names in the list")
    return str(value)


def _open_range(given: object, chips: int) -> tuple[int, int] | None:
    if given is None:
        return None
    ends: Sequence[Any] = given if isinstance(given, list) else []
    if len(ends) != 2 or not all(isinstance(end, int) and not isinstance(end, bool) for end in ends):
        raise FieldError("open", "the open chips are two whole numbers, the fewest and the most")
    low, high = ends
    if not 1 <= low <= high <= chips:
        raise FieldError("open", f"the open chips must lie within 1 to {chips}, the fewest first")
    return low, high
