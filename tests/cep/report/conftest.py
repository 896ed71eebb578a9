"""Chains of the demo on a small part of its scene."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.report.chain import STANDARD_CAMERA, run_chain
from cep.report.page import write_demo
from cep.report.scene import SceneMotion, bundled_scene
from motdiff.estimators.reference.estimator import ReferenceEstimator

LEVELS = (1000.0,)
CODING_CAMERA = Camera.load(STANDARD_CAMERA)
PLAIN_CAMERA = Camera.load("sony-imx250")


def small_scene(camera):
    return bundled_scene(camera, rng=np.random.default_rng(0), side_px=288)


def from_open_photo(scene):
    """Motion of the open photo, by the estimator that needs no luck."""
    return ReferenceEstimator(scene.sharp).estimate(scene.photo)


def chain_of(camera, **options):
    """Run the chain on a small part of the scene, from its open photo alone."""
    scene = small_scene(camera)
    return run_chain(
        scene, camera, motion=SceneMotion(from_open_photo(scene)), levels=LEVELS, **options
    )


@pytest.fixture(scope="session")
def coded():
    return chain_of(CODING_CAMERA, chips=16)


@pytest.fixture(scope="session")
def plain():
    return chain_of(PLAIN_CAMERA, chips=16)


@pytest.fixture(scope="session")
def calibrated():
    """A chain whose motion was estimated from photos through codes."""
    scene = small_scene(CODING_CAMERA)
    known = replace(scene.motion, direction="known")
    estimate = replace(
        from_open_photo(scene),
        method="coded",
        trajectories=(known,),
        weights=(1.0,),
        details={"path_uncertainty_px": 0.2},
    )
    codes = tuple(ShutterCode(bits) for bits in ("1111", "0110"))
    motion = SceneMotion(estimate, codes, (scene.photo, 0.5 * scene.photo))
    return run_chain(scene, CODING_CAMERA, motion=motion, levels=LEVELS, chips=16)


@pytest.fixture(scope="session")
def demo_of(tmp_path_factory):
    """The folder of a chain's demo and its figures, written once; tests may not change it."""
    demos = {}

    def demo(chain):
        if id(chain) not in demos:
            folder = tmp_path_factory.mktemp("demo")
            demos[id(chain)] = folder, write_demo(folder, chain)
        return demos[id(chain)]

    return demo


@pytest.fixture
def page_of(demo_of):
    """The page of a chain's demo, as it was written."""
    return lambda chain: (demo_of(chain)[0] / "report.html").read_text(encoding="utf-8")


@pytest.fixture(params=["coded", "plain", "calibrated"])
def either(request):
    return request.getfixturevalue(request.param)
