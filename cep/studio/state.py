"""State of the page as the server reads it: checked field by field, then as a problem, as
documents and as commands.
"""

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
from cep.files.formatting import seconds_of
from cep.studio.catalogue import camera_names, example_motion, load_profile, profile_names
from cep.studio.fields import (
    LIMITS,
    MOST_CHIPS,
    FieldError,
    is_number,
    is_text,
    read_bits,
    read_choice,
    read_number,
    read_whole,
)

_MOST_SAMPLES = 512  # of a path in the address
_TIME_STEPS = 65_535  # of a path in the address: 16 bits
_FARTHEST_PX = 500.0  # of a bent path: the work grows with its area, to some seconds of a picture
_MOST_ERROR_PX = 20.0
_MOST_EXPOSURE_S = 86_400.0
_MOST_STEPS = 10**9
_MOST_SEED = 2**32 - 1
_MOST_PINS = 12
_MOST_NAME = 80
_FIRST_PAGE: Mapping[str, Any] = {
    "motion": {"kind": "straight", "length": 40, "angle": 0},
    "bits": "1010000111000001010000110011110111010111001001100111",
    "exposure": "1/30",
    "camera": "aptina-mt9m031-8bit",
}
"""What a page begins with, as ``static/state.js`` has it."""
_SETTINGS = (
    "motion",
    "bits",
    "path_error",
    "exposure",
    "camera",
    "photons",
    "read_noise",
    "device",
)
_SIDES = ("open", "snapshot", "code")
_CHOICES = {"view": ("taken", "restored"), "left": _SIDES, "right": _SIDES}


@dataclass(frozen=True)
class Setting:
    """What the page is set to.

    Attributes
    ----------
    motion : mapping
        ``kind`` "straight" with ``length`` px and ``angle`` degrees, "example" with ``name``, or
        "path" with ``t``, ``x``, ``y`` and ``direction``.
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
        """Text that differs where anything but the bits and the path's error differs, the number
        of bits included.
        """
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
            camera = _camera(self.camera) if self.camera else cep.Camera()
            if self.photons is not None:
                camera = camera.at(self.photons)
            if self.read_noise is not None:
                camera = replace(camera, read_noise_e=self.read_noise)
            return camera
        except ValueError as error:
            raise FieldError.of(error, fallback="camera") from None

    @cached_property
    def profile(self) -> cep.DeviceProfile | None:
        """Shutter."""
        return _profile(self.device) if self.device else None

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
            # a device that cannot play such codes: they last as they would without it
            with suppress(FieldError):
                chip_ns = self.problem().chip_ns
        return cep.ShutterCode(self.bits if bits is None else bits, chip_ns)

    # -- what reproduces it -----------------------------------------------------------------------

    @property
    def motion_options(self) -> list[str]:
        """Options of the command line that name the motion."""
        if (
            self.motion["kind"] == "straight"
            and not self.motion["angle"]
            and not self.path_error_px
        ):
            return ["--linear", f"{self.motion['length']:g}"]
        return ["--trajectory", "trajectory.json"]

    @property
    def camera_options(self) -> list[str]:
        """Options of the command line that name the camera and the light."""
        options = {
            "--camera": self.camera or None,
            "--photons": self.photons,
            "--read-noise": self.read_noise,
        }
        return [
            word
            for name, value in options.items()
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
        """Return the command lines that give what the page shows, in a folder with its
        trajectory.json and code.json.

        Parameters
        ----------
        steps : int, optional
            Moves of a search that found the code.
        seed : int
        """
        motion = self.motion_options
        time = ["--exposure", self.exposure]
        light = self.camera_options
        device = self.device_options
        lines = [
            ["cep", "mtf", *motion, "--code", "code.json", "-o", "mtf.png"],
            ["cep", "audit", "code.json", *motion],
        ]
        if self.chips > 1:
            lines.insert(
                0,
                [
                    "cep",
                    "advise",
                    *motion,
                    "--code",
                    "code.json",
                    *light,
                    *device,
                    "-o",
                    "advice.png",
                ],
            )
        if steps is not None:
            search = ["--chips", str(self.chips), *time, *self.limit_options, *device, *light]
            rest_options = ["--steps", str(steps), "--seed", str(seed), "-o", "searched.json"]
            lines.insert(0, ["cep", "optimize", *motion, *search, *rest_options])
        return [shlex.join(line) for line in lines]


@lru_cache(maxsize=32)
def _camera(name: str) -> cep.Camera:
    return cep.Camera.load(name)


@lru_cache(maxsize=32)
def _profile(name: str) -> cep.DeviceProfile:
    return load_profile(name)


def read_setting(document: object) -> Setting:
    """Read the state that the page sends.

    Raises
    ------
    FieldError
        If a field is missing or malformed; the line says what would be right.
    """
    if not isinstance(document, dict):
        raise FieldError("page", f"the state must be an object, got {type(document).__name__}")
    bits = read_bits(document.get("bits"), "bits")
    motion, trajectory = _motion(document.get("motion"))
    return Setting(
        motion=motion,
        trajectory=trajectory,
        bits=bits,
        path_error=read_number(document, "path_error", 0.0, _MOST_ERROR_PX, "px"),
        exposure=_exposure(document.get("exposure", "50ms")),
        camera=read_choice(document, "camera", camera_names(), default=""),
        photons=read_number(document, "photons", 1.0, 1e7, "photo-electrons at full scale"),
        read_noise=read_number(document, "read_noise", 0.0, 1e5, "electrons of read noise"),
        device=read_choice(document, "device", profile_names(), default=""),
        open_range=_open_range(document.get("open"), len(bits)),
        limits={
            name: value
            for name in LIMITS
            if (
                value := read_whole(
                    document, name, 1, MOST_CHIPS, "openings" if name == "max_pulses" else "chips"
                )
            )
            is not None
        },
    )


def read_search(document: Mapping[str, Any]) -> tuple[int | None, int]:
    """Read the ``steps`` of a search, None where it says nothing of them, and its ``seed``.

    Raises
    ------
    FieldError
    """
    steps = read_whole(document, "steps", 1, _MOST_STEPS, "moves of a search")
    return steps, read_whole(document, "seed", 0, _MOST_SEED, "as a seed") or 0


def read_codes(codes: object, field: str, *, limit: int = _MOST_PINS) -> Mapping[str, str]:
    """Read codes by their names.

    Raises
    ------
    FieldError
        Beside the field, if there is none, there are more than ``limit``, or a name or a code is
        malformed.
    """
    if not isinstance(codes, dict) or not 1 <= len(codes) <= limit:
        raise FieldError(field, f"needs 1 to {limit} codes by their names")
    if not all(is_text(name, _MOST_NAME) for name in codes):
        raise FieldError(field, f"a code has a name of up to {_MOST_NAME} printable characters")
    return {name: read_bits(bits, field) for name, bits in codes.items()}


def read_state(document: object) -> dict[str, Any]:
    """Read the state of a page, as ``studio.json`` has it.

    Returns
    -------
    dict
        The fields that the document has, each checked; fields that are not known are left out.

    Raises
    ------
    FieldError
        If a field is malformed.
    """
    if not isinstance(document, dict):
        raise FieldError("page", f"the state must be an object, got {type(document).__name__}")
    setting = saved_setting(document)
    fields = {name: getattr(setting, name) for name in _SETTINGS} | {
        "open": None if setting.open_range is None else list(setting.open_range),
        **{name: setting.limits.get(name) for name in LIMITS},
        **{
            name: read_choice(document, name, names, default=names[0])
            for name, names in _CHOICES.items()
        },
        "photo": _photo(document.get("photo")),
        "pins": _pins(document.get("pins")),
        "search": _search(document.get("search")),
    }
    return {name: value for name, value in fields.items() if name in document}


def saved_setting(state: Mapping[str, Any]) -> Setting:
    """Return the setting of a page's state; what it leaves out is as on the first page.

    Raises
    ------
    FieldError
    """
    return read_setting({**_FIRST_PAGE, **state})


def path_fields(trajectory: cep.Trajectory, *, max_samples: int = 160) -> dict[str, Any]:
    """Return a motion as the page keeps it in its address: thinned to at most so many samples,
    times in 16 bits.

    Samples of a fast jump that fall on the same time are moved to the next ones.
    """
    path = trajectory
    tolerance_px = 0.005
    while path.t.size > max_samples:
        path = trajectory.thinned(tolerance_px)
        tolerance_px = 1.4 * tolerance_px
    order = np.arange(path.t.size)
    steps = np.maximum.accumulate(np.rint(_TIME_STEPS * path.t) - order) + order
    t = np.minimum(steps, _TIME_STEPS - order[::-1]) / _TIME_STEPS
    samples = {
        name: np.round(values, 5).tolist() for name, values in (("x", path.x), ("y", path.y))
    }
    return {"kind": "path", "direction": path.direction, "t": t.tolist(), **samples}


def _motion(motion: object) -> tuple[Mapping[str, Any], cep.Trajectory]:
    if not isinstance(motion, dict):
        raise FieldError("motion", "the motion must be an object with its kind")
    kind = motion.get("kind")
    if kind == "straight":
        length = read_number(motion, "length", 1.0, 1_000.0, "px")
        angle = read_number(motion, "angle", -360.0, 360.0, "degrees") or 0.0
        if length is None:
            raise FieldError("length", "a straight motion needs its length in px")
        return {"kind": kind, "length": length, "angle": angle}, cep.Trajectory.straight(
            length, angle_rad=math.radians(angle)
        )
    if kind == "example":
        name = motion.get("name")
        try:
            return {"kind": kind, "name": name}, example_motion(
                name if isinstance(name, str) else ""
            )
        except ValueError as error:
            raise FieldError("motion", str(error).removeprefix("motion: ")) from None
    if kind != "path":
        raise FieldError("motion", "the kind of a motion is straight, example or path")
    columns = [motion.get(name) for name in "txy"]
    sizes = {len(column) if isinstance(column, list) else -1 for column in columns}
    if len(sizes) != 1 or not 2 <= sizes.pop() <= _MOST_SAMPLES:
        raise FieldError(
            "motion", f"a path has 2 to {_MOST_SAMPLES} samples, as many of t as of x and y"
        )
    if not all(is_number(value) for column in columns for value in column or ()):
        raise FieldError("motion", "t, x and y of a path are finite numbers")
    t, x, y = (np.array(column, dtype=np.float64) for column in columns)
    if max(np.abs(x).max(), np.abs(y).max()) > _FARTHEST_PX:
        raise FieldError("motion", f"a path lies within {_FARTHEST_PX:g} px")
    direction: Literal["known", "unknown"] = (
        "known" if motion.get("direction") == "known" else "unknown"
    )
    try:
        path = cep.Trajectory.from_samples(np.column_stack([x, y]), t=t, direction=direction)
    except ValueError as error:
        raise FieldError("motion", str(error).removeprefix("trajectory: ")) from None
    if path.extent_px < 1e-3:
        raise FieldError("motion", "the path stays in place; a motion is needed")
    return {
        "kind": kind,
        "t": t.tolist(),
        "x": x.tolist(),
        "y": y.tolist(),
        "direction": direction,
    }, path


def _exposure(exposure: object) -> str:
    if not is_text(exposure, 20) or not exposure.isascii():
        raise FieldError("exposure", "the exposure is a time as 1/30, 20ms or 500us")
    try:
        exposure_s = seconds_of(exposure)
    except ValueError as error:
        raise FieldError.of(error) from None
    if not 1e-9 <= exposure_s <= _MOST_EXPOSURE_S:
        raise FieldError("exposure", f"must be a time within 1ns to {_MOST_EXPOSURE_S:g}s")
    return exposure


def _photo(key: object) -> str:
    """Return the key of an upload, empty where there is none."""
    if key is None:
        return ""
    if not is_text(key, _MOST_NAME):
        raise FieldError("photo", "must be the key of a photo")
    return key


def _pins(pins_given: object) -> list[dict[str, str]]:
    if pins_given is None or pins_given == []:
        return []
    pins: Sequence[Any] = pins_given if isinstance(pins_given, list) else [None]
    if not all(isinstance(pin, dict) and isinstance(pin.get("name"), str) for pin in pins):
        raise FieldError("pins", "must be a list of codes with their name and bits")
    codes = read_codes({pin["name"]: pin.get("bits") for pin in pins}, "pins")
    if len(codes) < len(pins):
        raise FieldError("pins", "every code needs a name of its own")
    return [{"name": name, "bits": bits} for name, bits in codes.items()]


def _search(search: object) -> dict[str, int] | None:
    if search is None:
        return None
    steps, seed = read_search(search) if isinstance(search, dict) else (None, 0)
    if steps is None:
        raise FieldError("search", "must be an object with the steps and the seed of a search")
    return {"steps": steps, "seed": seed}


def _open_range(bounds: object, chips: int) -> tuple[int, int] | None:
    if bounds is None:
        return None
    limits: Sequence[Any] = bounds if isinstance(bounds, list) else ()
    if len(limits) != 2 or not all(
        isinstance(end, int) and not isinstance(end, bool) for end in limits
    ):
        raise FieldError("open", "the open chips are two whole numbers, the fewest and the most")
    low, high = limits
    if not 1 <= low <= high <= chips:
        raise FieldError("open", f"the open chips must lie within 1 to {chips}, the fewest first")
    return low, high
