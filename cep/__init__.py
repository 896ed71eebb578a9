"""Coded exposure: from a blurred photo to the shutter code for its motion, and a sharp photo.

Each name is imported when it is first used, so that ``import cep`` is instant.

Examples
--------
The code of 2006 keeps every frequency of a straight motion; the open shutter loses some for good:

>>> import cep
>>> path = cep.Trajectory.straight(52.0)
>>> classic = cep.load_code("raskar-52")
>>> proven = cep.certify(classic)
>>> print(f"{proven.lower:.4f} {proven.unit}, {bool(cep.verify(proven))}")
1.3237 chips, True
>>> print(f"{cep.mtf(path, None, 1 / 52, 0):.3f} {cep.mtf(path, classic, 1 / 52, 0):.3f}")
0.000 0.084
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cep.calibration.calibrate import estimate_motion
    from cep.calibration.refine import refine_motion
    from cep.codes.sources import load_code
    from cep.files.images import read_image, write_image
    from cep.optics.camera import Camera
    from cep.optics.capture import capture
    from cep.optics.code import ShutterCode
    from cep.optics.exposure import coded_psf, mtf
    from cep.proofs.audit import audit
    from cep.proofs.certify.certificate import certify
    from cep.proofs.verify import verify
    from cep.restoration.direction import detect_direction
    from cep.restoration.restore import restore
    from cep.restoration.together import restore_together
    from cep.search.advise import advise
    from cep.search.baselines import compare
    from cep.search.bounds import bound
    from cep.search.limits import RunLimits
    from cep.search.optimize import optimize
    from cep.search.problem import SearchProblem
    from cep.shutter.exposure_plan import ShotSettings
    from cep.shutter.play import open_shutter
    from cep.shutter.playback import read_playback
    from cep.shutter.shoot import shoot
    from cep.shutter.timing import time_camera
    from hw.device import DeviceProfile
    from motdiff.files.gyro_tables import read_gyro
    from motdiff.trajectory import Trajectory

__all__ = [
    "Camera",
    "DeviceProfile",
    "RunLimits",
    "SearchProblem",
    "ShotSettings",
    "ShutterCode",
    "Trajectory",
    "__version__",
    "advise",
    "audit",
    "bound",
    "capture",
    "certify",
    "coded_psf",
    "compare",
    "detect_direction",
    "estimate_motion",
    "load_code",
    "mtf",
    "open_shutter",
    "optimize",
    "read_gyro",
    "read_image",
    "read_playback",
    "refine_motion",
    "restore",
    "restore_together",
    "shoot",
    "time_camera",
    "verify",
    "write_image",
]

_MODULES = {
    "Camera": "cep.optics.camera",
    "DeviceProfile": "hw.device",
    "RunLimits": "cep.search.limits",
    "SearchProblem": "cep.search.problem",
    "ShotSettings": "cep.shutter.exposure_plan",
    "ShutterCode": "cep.optics.code",
    "Trajectory": "motdiff.trajectory",
    "advise": "cep.search.advise",
    "audit": "cep.proofs.audit",
    "bound": "cep.search.bounds",
    "capture": "cep.optics.capture",
    "certify": "cep.proofs.certify.certificate",
    "coded_psf": "cep.optics.exposure",
    "compare": "cep.search.baselines",
    "detect_direction": "cep.restoration.direction",
    "estimate_motion": "cep.calibration.calibrate",
    "load_code": "cep.codes.sources",
    "mtf": "cep.optics.exposure",
    "open_shutter": "cep.shutter.play",
    "optimize": "cep.search.optimize",
    "read_gyro": "motdiff.files.gyro_tables",
    "read_image": "cep.files.images",
    "read_playback": "cep.shutter.playback",
    "refine_motion": "cep.calibration.refine",
    "restore": "cep.restoration.restore",
    "restore_together": "cep.restoration.together",
    "shoot": "cep.shutter.shoot",
    "time_camera": "cep.shutter.timing",
    "verify": "cep.proofs.verify",
    "write_image": "cep.files.images",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        # kept in the module, so that the next use finds it without this function
        member = globals()[name] = getattr(import_module(_MODULES[name]), name)
        return member
    if name == "__version__":  # importlib.metadata is a tenth of what `cep --help` may take
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("coded-exposure")
        except PackageNotFoundError:
            return "0+unknown"  # it runs uninstalled
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
