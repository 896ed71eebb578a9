"""Choices of the page by name: cameras, shutters, example motions, export formats, ports."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from cep.optics.camera import camera_names as camera_names
from cep.shutter.cameras import CAMERAS
from hw.cameras import camera_class
from hw.device import DeviceProfile
from hw.device import load_profile as load_profile  # state.py takes the house's names from here
from hw.device import profile_names as profile_names
from hw.export import EXPORTERS
from hw.port import list_ports
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory

_EXAMPLES = {
    "shake": "a hand that accelerates: a bent path of 26 px",
    "turn": "a turntable: an arc of 40 px at constant speed, of known direction",
    "start": "a conveyor that starts: straight, 32 px, ever faster, of known direction",
    "walk": "a random walk with reversals, 60 px",
}
_THIN_PX = 0.05  # of paths of 2,000 samples, far below what a photo shows


@dataclass(frozen=True)
class Choice:
    """A choice: its name, as options take it, and a line about it."""

    name: str
    about: str


def devices() -> tuple[Choice, ...]:
    """List the shutters with a profile."""
    return tuple(Choice(name, load_profile(name).description) for name in profile_names())


def shutter_name(profile: DeviceProfile) -> str | None:
    """Return the name of a shutter of :func:`devices` by its profile, None for one's own."""
    return next((name for name in profile_names() if load_profile(name) == profile), None)


def formats() -> tuple[Choice, ...]:
    """List the formats of :func:`hw.export.export_program`."""
    return tuple(Choice(name, exporter.summary) for name, exporter in EXPORTERS.items())


def camera_kinds() -> tuple[Choice, ...]:
    """List the kinds of camera that take photos."""
    return tuple(Choice(kind, camera_class(kind, CAMERAS).summary) for kind in CAMERAS)


def ports() -> tuple[Choice, ...]:
    """List the serial ports of this machine."""
    return tuple(Choice(info.port, info.description) for info in list_ports())


def example_motion(name: str) -> Trajectory:
    """Return an example motion; ValueError where there is none of that name.

    Examples
    --------
    >>> round(example_motion("walk").length_px)
    60
    """
    if name not in _EXAMPLES:
        raise ValueError(
            f"motion: there is no example {name[:40]!r}; there are {', '.join(_EXAMPLES)}"
        )
    return _drawn(name)


def example_motions() -> tuple[Choice, ...]:
    """List the example motions."""
    return tuple(Choice(name, about) for name, about in _EXAMPLES.items())


@cache
def _drawn(name: str) -> Trajectory:
    t = np.linspace(0, 1, 33)
    if name == "shake":
        # a fixed draw: pages and files store no more than the example's name
        shake = quadratic(
            np.random.default_rng(0), min_length_px=24, max_length_px=28, max_bend=1.5
        )
        return shake.thinned(_THIN_PX)
    if name == "turn":
        angle = np.pi / 2 * (t - 0.5)
        radius = 40 / (np.pi / 2)
        return Trajectory.from_samples(
            radius * np.stack([np.sin(angle), np.cos(angle)], axis=1), direction="known"
        )
    if name == "start":
        return Trajectory.from_samples(32 * np.stack([t**2, 0 * t], axis=1), direction="known")
    return boracchi_foi(np.random.default_rng(7)).thinned(_THIN_PX)
