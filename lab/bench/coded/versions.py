"""Versions of the cells of the coded table: fingerprints of the code that makes them."""

from __future__ import annotations

from pathlib import Path

from lab.bench.coded.calibrations import (
    POINT,
)
from lab.bench.coded.estimates import ESTIMATORS
from lab.jobs.fingerprint import source_version
from lab.weights import PATH_WEIGHTS
from motdiff import weights as shipped
from motdiff.files.plugins import is_reference

_DENOISER = Path(__file__).parents[3] / "cep/restoration/denoiser/denoiser.safetensors"
_HERE = "lab.bench.coded"
_PATHS = f"{_HERE}.protocol"
_CALIBRATIONS = f"{_HERE}.calibrations"
_EXPOSED = (
    _PATHS,
    f"{_HERE}.stages",
    "lab.bench.datasets",
    "lab.bench.psf_text",
    "cep.files.images",
    "cep.files.raw_files",
    "motdiff.files.decoding",
    "motdiff.crops",
    "motdiff.photo_values",
)
"""From the file to the photo."""
_ESTIMATED: dict[str, tuple[str, tuple[Path, ...]]] = {
    "motdiff": ("motdiff.estimators.motdiff", (shipped.CORRECTION_WEIGHTS, shipped.PATH_WEIGHTS)),
    "parametric": ("lab.rivals.parametric", (PATH_WEIGHTS,)),
}
_BASELINES = "cep.search.baselines"
_PUBLISHED = "cep.codes.published"
_SEARCHED = ("cep.search.annealing.anneal", _BASELINES, _PUBLISHED)  # searches start from both
_CHOSEN = {
    "open": ("cep.optics.code",),
    "snapshot": (_BASELINES,),
    "class-snapshot": (_BASELINES,),
    "strobe": (_BASELINES,),
    "random": (_BASELINES,),
    "raskar-52": (_PUBLISHED,),
    "dnf": _SEARCHED,
    "dce": ("lab.trainings.dce.shipped_code",),
}


def motion_version(kind: str) -> str:
    """Cache version of the motions: fingerprint of what finds a kind of path, estimated or
    calibrated.
    """
    shared = ["motdiff.metrics", "motdiff.simulate", "cep.optics.camera"]
    if kind in ESTIMATORS:
        module, weights = _ESTIMATED[ESTIMATORS[kind]]
        return source_version(
            [module, *shared], alone=[*_EXPOSED, "lab.evaluation.methods"], files=weights
        )
    module = f"motdiff.estimators.coded.{'trail_estimator' if kind == POINT else 'estimator'}"
    return source_version([module, *shared], alone=[*_EXPOSED, _CALIBRATIONS])


def kernel_version() -> str:
    """Cache version of the kernels found in the photos themselves."""
    modules = [
        "cep.restoration.restore",
        "motdiff.metrics",
        "motdiff.simulate",
        "cep.optics.camera",
    ]
    return source_version(modules, alone=_EXPOSED)


def code_version(design: str) -> str:
    """Cache version of the codes: fingerprint of a design of
    :data:`lab.bench.coded.designs.DESIGNS`.
    """
    return source_version(
        _CHOSEN.get(design, _SEARCHED), alone=[_PATHS, f"{_HERE}.designs", f"{_HERE}.stages"]
    )


def photo_version(restoration: str) -> str:
    """Cache version of the photos: fingerprint of capture, restoration and comparison.

    Of a restoration of the user's own, the module that it names counts, and what of ours that
    module imports.
    """
    modules = ["cep.restoration", "cep.proofs.measure", "motdiff.metrics", "motdiff.simulate"]
    modules += [restoration.partition(":")[0]] if is_reference(restoration) else []
    return source_version(modules, alone=_EXPOSED, files=[_DENOISER])


def set_version() -> str:
    """Cache version of the sets of calibration codes."""
    return source_version(["cep.calibration.calibration_set"], alone=[_CALIBRATIONS])
