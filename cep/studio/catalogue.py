"""What can be chosen by name: cameras, shutters, published codes, example motions, export formats,
serial ports.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from cep.codes.published import for_chips, names
from cep.optics.camera import Camera
from cep.optics.camera import camera_names as camera_names
from cep.optics.code import ShutterCode
from hw.device import DeviceProfile
from hw.device import load_profile as load_profile
from hw.device import profile_names as profile_names
from hw.export import EXPORTERS
from hw.port import list_ports
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory

_THIN_PX = 0.05  # of the walk's 2000 samples


@dataclass(frozen=True)
class Choice:
    """One thing that can be chosen.

    Attributes
    ----------
    name : str
        As options take it.
    about : str
        What it is, in a line.
    """

    name: str
    about: str


def cameras() -> tuple[tuple[Choice, Camera], ...]:
    """List the known cameras."""
    known = ((name, Camera.load(name)) for name in camera_names())
    return tuple((Choice(name, camera.kind), camera) for name, camera in known)


def devices() -> tuple[Choice, ...]:
    """List the shutters with a profile."""
    return tuple(Choice(name, load_profile(name).description) for name in profile_names())


def shutter_name(profile: DeviceProfile) -> str | None:
    """Return the name of a shutter of :func:`devices` by its profile, None for one's own."""
    return next((name for name in profile_names() if load_profile(name) == profile), None)


def formats() -> tuple[Choice, ...]:
    """List the formats of :func:`cep.shutter.play.export_code`."""
    return tuple(Choice(name, exporter.summary) for name, exporter in EXPORTERS.items())


def ports() -> tuple[Choice, ...]:
    """List the serial ports of this machine."""
    return tuple(Choice(info.port, info.description) for info in list_ports())


def published_codes(chips: int) -> tuple[tuple[Choice, ShutterCode], ...]:
    """List the published codes of so many chips.

    Examples
    --------
    >>> [choice.name for choice, _ in published_codes(52)]
    ['raskar-52']
    """
    return tuple((Choice(entry.name, entry.source), entry.code) for entry in for_chips(chips))


def published_chips() -> tuple[tuple[str, int], ...]:
    """List the names of all published codes with their numbers of chips, shortest first."""
    from cep.codes.sources import load_code

    return tuple((name, load_code(name).chips) for name in names())


def example_motion(name: str) -> Trajectory:
    """Return an example motion.

    Raises
    ------
    ValueError
        If there is none of that name.

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


_EXAMPLES = {
    "shake": "a hand that accelerates: a bent path of 26 px",
    "turn": "a turntable: an arc of 40 px at constant speed, of known direction",
    "start": "a conveyor that starts: straight, 32 px, ever faster, of known direction",
    "walk": "a random walk with reversals, 60 px",
}


@cache
def _drawn(name: str) -> Trajectory:
    t = np.linspace(0, 1, 33)
    if name == "shake":
        found = quadratic(
            np.random.default_rng(0), min_length_px=24, max_length_px=28, max_bend=1.5
        )
        return found.thinned(_THIN_PX)
    if name == "turn":
        turned = np.pi / 2 * (t - 0.5)
        radius = 40 / (np.pi / 2)
        return Trajectory.from_samples(
            radius * np.stack([np.sin(turned), np.cos(turned)], axis=1), direction="known"
        )
    if name == "start":
        return Trajectory.from_samples(32 * np.stack([t**2, 0 * t], axis=1), direction="known")
    return boracchi_foi(np.random.default_rng(7)).thinned(_THIN_PX)
