"""Cache versions of the coded table: what an edit makes anew."""

from pathlib import Path

from lab.bench.coded import versions as module
from lab.bench.coded.calibrations import (
    POINT,
)
from lab.bench.coded.designs import DESIGNS
from lab.bench.coded.estimates import ESTIMATORS
from lab.bench.coded.versions import code_version, motion_version, photo_version
from motdiff.estimators.coded.estimator import CodedEstimator
from motdiff.estimators.coded.trail_estimator import TrailEstimator


def test_a_changed_method_is_measured_again_alone(monkeypatch):
    before = (
        {design: code_version(design) for design in DESIGNS},
        photo_version("pnp"),
        motion_version("parametric"),
    )
    real = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda self: b"new" if self.suffix == ".safetensors" else real(self)
    )
    after = (
        {design: code_version(design) for design in DESIGNS},
        photo_version("pnp"),
        motion_version("parametric"),
    )
    assert before[0] == after[0]  # no code is chosen by a network
    assert before[1] != after[1]  # the denoiser's, with which a protocol may restore
    assert before[2] != after[2]
    assert set(ESTIMATORS.values()) == {"motdiff", "parametric"}
    assert motion_version("ours") != motion_version("parametric")


def test_edits_of_what_finds_a_calibrated_path_count(monkeypatch):
    real = module.source_version
    seen = []

    def watched(modules, **others):
        seen.extend(modules)
        return real(modules, **others)

    monkeypatch.setattr(module, "source_version", watched)
    versions = {motion_version(kind) for kind in (POINT, "open + one")}
    assert len(versions) == 2
    assert TrailEstimator.__module__ in seen
    assert CodedEstimator.__module__ in seen
