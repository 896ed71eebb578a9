"""When what was measured of the coded-exposure table counts no longer: versions of its stages, from their sources."""

from __future__ import annotations

from pathlib import Path

from cep.baselines.dce.shipped import SHIPPED
from cep.bench.sources import source_version
from motdiff.weights import DEFAULT_WEIGHTS, PATH_WEIGHTS

__all__ = ["code_version", "motion_version", "photo_version"]

_DENOISER = Path(__file__).parents[2] / "restore" / "denoiser" / "denoiser.safetensors"
_HERE = "cep.bench.coded"
_PATHS = f"{_HERE}.paths"
_EXPOSED = (_PATHS, f"{_HERE}.work", "cep.bench.scenes", "cep.bench.photos", "cep.images", "motdiff.crops")
"""From the file to the photo."""
_ESTIMATED: dict[str, tuple[str, Path]] = {
    "motdiff-quick": ("motdiff.estimators.motdiff", DEFAULT_WEIGHTS),
    "parametric": ("motdiff.estimators.parametric", PATH_WEIGHTS),
}
_LIGHT = "cep.baselines.light"
_PUBLISHED = "cep.baselines.published"
_SEARCHED = ("cep.search.annealing.anneal", _LIGHT, _PUBLISHED)  # searches start from both
_CHOSEN = {
    "open": ("cep.code",),
    "snapshot": (_LIGHT,),
    "strobe": (_LIGHT,),
    "random": (_LIGHT,),
    "raskar-52": (_PUBLISHED,),
    "dnf": ("cep.baselines.dnf", *_SEARCHED),
    "dce": ("cep.baselines.dce.shipped",),
}


def motion_version(method: str) -> str:
    """Fingerprint of what estimates a motion: an estimator of :data:`cep.bench.coded.told.ESTIMATORS`."""
    module, weights = _ESTIMATED[method]
    used = [module, "motdiff.metrics", "motdiff.simulate", "cep.camera"]
    return source_version(used, alone=[*_EXPOSED, f"{_HERE}.calibrated", "motdiff.evaluation.methods"], files=[weights])


def code_version(design: str) -> str:
    """Fingerprint of what chooses a code: a design of :data:`cep.bench.coded.designs.DESIGNS`."""
    files = [SHIPPED] if design == "dce" else []
    return source_version(
        _CHOSEN.get(design, _SEARCHED), alone=[_PATHS, f"{_HERE}.designs", f"{_HERE}.chosen"], files=files
    )


def photo_version() -> str:
    """Fingerprint of what takes, restores and compares a photo."""
    used = ["cep.restore", "cep.mtf", "motdiff.metrics", "motdiff.simulate"]
    return source_version(used, alone=[*_EXPOSED, f"{_HERE}.taken"], files=[_DENOISER])
