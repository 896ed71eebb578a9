"""State of the page: checked field by field, then a search problem, a document and commands.

What reads a part of it raises :class:`cep.studio.fields.FieldError`.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import cep
from cep.files.formatting import option_words, seconds_of
from cep.optics.camera import camera_names
from cep.studio.fields import (
    LIMITS,
    MOST_CHIPS,
    FieldError,
    is_text,
    read_bits,
    read_choice,
    read_number,
    read_whole,
)
from cep.studio.motions import page_motion
from hw.device import load_profile, profile_names

_MOST_ERROR_PX = 20.0
_MOST_EXPOSURE_S = 86_400.0  # a day
_MOST_STEPS = 10**9
_MOST_SEED = 2**32 - 1
_MOST_PINS = 12
_MOST_NAME = 80  # characters
# what a page begins with, as static/state.js has it
_FIRST_PAGE: Mapping[str, Any] = {
    "motion": {"kind": "straight", "length": 40, "angle": 0},
    "bits": "1010000111000001010000110011110111010111001001100111",
    "exposure": "1/30",
    "camera": "aptina-mt9m031-8bit",
}
# fields of the page and of Setting that have the same name and form
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
# each request of a page asks for them again
_camera = lru_cache(maxsize=32)(cep.Camera.load)
_profile = lru_cache(maxsize=32)(load_profile)
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
        """Text of all that a bench depends on: not which chips are open, nor the path's error."""
        light = (self.camera, self.photons, self.read_noise)
        limits = (self.device, self.open_range, sorted(self.limits.items()))
        return repr((self.chips, self.motion, self.exposure, light, limits))

    @cached_property
    def sensor(self) -> cep.Camera:
        """Camera at its light."""
        try:
            camera = cep.Camera()
            if self.camera:
                camera = _camera(self.camera)
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
        """Return the search problem; without its limits where codes are only to be measured."""
        # a camera's shortest exposure is a limit on codes too
        limits: dict[str, Any] = {"camera": replace(self.sensor, least_exposure_s=0.0)}
        if limited:
            limits = {
                "camera": self.sensor,
                "device": self.profile,
                "open_range": self.open_range,
                "runs": cep.RunLimits(**self.limits),
            }
        try:
            return cep.SearchProblem.along(
                self.trajectory,
                chips=self.chips,
                exposure_s=seconds_of(self.exposure),
                objective="mse",
                **limits,
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
        return cep.ShutterCode(bits or self.bits, chip_ns)

    # -- what reproduces it -----------------------------------------------------------------------

    def commands(self, *, steps: int | None = None, seed: int = 0) -> list[str]:
        """Return the command lines that give what the page shows.

        They are for a folder with its trajectory.json and code.json.

        Parameters
        ----------
        steps : int, optional
            Moves of a search that found the code.
        """
        motion = ["--trajectory", "trajectory.json"]
        angle = self.motion.get("angle")
        if self.motion["kind"] == "straight" and not angle and not self.path_error_px:
            motion = option_words({"--linear": self.motion["length"]})
        camera: dict[str, str | float | None] = {
            "--camera": self.camera or None,
            "--photons": self.photons,
            "--read-noise": self.read_noise,
        }
        device = {"--device": self.device or None}
        lines = []
        if steps is not None:
            limits = option_words(
                {
                    "--chips": str(self.chips),
                    "--exposure": self.exposure,
                    "--open": self.open_range and "{}:{}".format(*self.open_range),
                    **{
                        f"--{name.replace('_', '-')}": limit for name, limit in self.limits.items()
                    },
                    **device,
                    **camera,
                    "--steps": str(steps),  # whole, as 1e+06 would not be read back
                    "--seed": str(seed),
                }
            )
            lines.append(["cep", "optimize", *motion, *limits, "-o", "searched.json"])
        if self.chips > 1:  # a single chip leaves nothing to choose
            light = option_words({**camera, **device})
            code = ["--code", "code.json"]
            lines.append(["cep", "advise", *motion, *code, *light, "-o", "advice.png"])
        lines += [
            ["cep", "mtf", *motion, "--code", "code.json", "-o", "mtf.png"],
            ["cep", "audit", "code.json", *motion],
        ]
        return [shlex.join(line) for line in lines]


def read_setting(document: object) -> Setting:
    """Read the state that the page sends."""
    if not isinstance(document, dict):
        raise FieldError("page", f"the state must be an object, got {type(document).__name__}")
    bits = read_bits(document.get("bits"), "bits")
    motion, trajectory = page_motion(document.get("motion"))
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
            if (value := read_whole(document, name, 1, MOST_CHIPS, "chips")) is not None
        },
    )


def read_search(document: Mapping[str, Any]) -> tuple[int | None, int]:
    """Read the ``steps`` of a search, None where it says nothing of them, and its ``seed``."""
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
    """
    if not isinstance(document, dict):
        raise FieldError("page", f"the state must be an object, got {type(document).__name__}")
    setting = saved_setting(document)
    fields = {name: getattr(setting, name) for name in _SETTINGS} | {
        "open": setting.open_range and list(setting.open_range),
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
    """Return the setting of a page's state; what it leaves out is as on the first page."""
    return read_setting({**_FIRST_PAGE, **state})


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


def _pins(pins: object) -> list[dict[str, str]]:
    if pins is None or pins == []:
        return []
    if not isinstance(pins, list) or not all(
        isinstance(pin, dict) and isinstance(pin.get("name"), str) for pin in pins
    ):
        raise FieldError("pins", "must be a list of codes with their name and bits")
    codes = read_codes({pin["name"]: pin.get("bits") for pin in pins}, "pins")
    if len(codes) < len(pins):  # a dict has kept one of each name
        raise FieldError("pins", "every code needs a name of its own")
    return [{"name": name, "bits": bits} for name, bits in codes.items()]


def _search(search: object) -> dict[str, int] | None:
    if search is None:
        return None
    if isinstance(search, dict):
        steps, seed = read_search(search)
        if steps is not None:
            return {"steps": steps, "seed": seed}
    raise FieldError("search", "must be an object with the steps and the seed of a search")


def _open_range(bounds: object, chips: int) -> tuple[int, int] | None:
    if bounds is None:
        return None
    # not isinstance: True is an int too
    if not isinstance(bounds, list) or [type(end) for end in bounds] != [int, int]:
        raise FieldError("open", "the open chips are two whole numbers, the fewest and the most")
    low, high = bounds
    if not 1 <= low <= high <= chips:
        raise FieldError("open", f"the open chips must lie within 1 to {chips}, the fewest first")
    return low, high
