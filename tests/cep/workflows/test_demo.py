"""The whole chain, its files and its report; on a small budget, with the estimator that needs no luck."""

import json
import re

import numpy as np
import pytest

from cep.io.files import read_code
from cep.io.images import read_photo
from cep.optics.camera import LIGHT_LEVELS, Camera
from cep.report.demo_page import DEMO_PICTURES, demo_report, verdict
from cep.report.result_page import html
from cep.workflows.demo import DEMO_FILES, write_demo
from cep.workflows.demo_chain import Scene, bundled_scene, own_photo, run_chain
from hw.export import EXPORTERS
from motdiff.estimators.reference import ReferenceEstimator
from motdiff.io.trajectories import read_motion

CAMERA = Camera()


@pytest.fixture(scope="module")
def chain():
    whole = bundled_scene(CAMERA, rng=np.random.default_rng(0))
    # a part of the scene is enough, and quicker
    scene = Scene(whole.name, whole.photo[100:356, 100:356], whole.sharp[100:400, 100:400], whole.motion)
    return run_chain(scene, CAMERA, estimator=ReferenceEstimator(scene.sharp), steps=4000, chips=16)


def test_the_bundled_scene_repeats_and_moves():
    first, second = (bundled_scene(CAMERA, rng=np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first.photo, second.photo)
    assert 20 < first.motion.length_px < 30
    assert first.photo.shape[0] < first.sharp.shape[0]


def test_the_chain_closes(chain):
    shots = {shot.name: shot for shot in chain.shots}
    assert list(shots)[:2] == ["open shutter", "coded"]
    assert shots["coded"].code == chain.code
    assert chain.code.chips == 16
    assert 0.35 <= chain.code.duty <= 0.75
    # restoring helps: each is better than its own blurred photo at the same scale
    for shot in chain.shots:
        blurred = shot.photo.mean(axis=2) / shot.code.duty
        error = blurred - chain.reference.mean(axis=2)
        assert shot.psnr_db > -10 * np.log10(np.mean(error[30:-30, 30:-30] ** 2)) + 2
    # a perfect estimate is never worse by more than the search for the best shift can hide
    assert shots["coded, true motion"].psnr_db > shots["coded"].psnr_db - 0.3
    assert chain.seconds[0][0] == "estimating the motion"


def test_files_and_figures(chain, tmp_path):
    figures = write_demo(tmp_path / "out", chain)
    assert {item.name for item in (tmp_path / "out").iterdir()} == set(DEMO_FILES)
    assert json.loads((tmp_path / "out/demo.json").read_text())["bits"] == chain.code.bits == figures["bits"]
    assert read_code(tmp_path / "out/code.json").code == chain.code
    assert read_motion(tmp_path / "out/trajectory.json").trajectory.length_px == pytest.approx(chain.motion.length_px)
    for name, suffix in (("c", ".h"), ("csv", ".csv"), ("json", ".json")):
        text = (tmp_path / "out" / f"shutter_code{suffix}").read_text()
        assert EXPORTERS[name].parse_back(text).bits == chain.code.bits
    assert read_photo(tmp_path / "out/coded.png").bits == 16
    for name in DEMO_PICTURES:
        assert (tmp_path / f"out/{name}.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="use --force"):
        write_demo(tmp_path / "out", chain)
    write_demo(tmp_path / "out", chain, force=True)


def test_the_report_says_what_was_measured(chain):
    report = demo_report(chain)
    page = html(report)
    assert page.count("data:image/png;base64,") >= 5
    for shot in chain.shots:
        assert f"{shot.psnr_db:.4g}" in page
    assert chain.code.bits in page
    assert not re.search(r"\bnan\b|\binf\b", re.sub(r"base64,[^\"]*", "", page))
    gain = chain.shots[1].psnr_db - chain.shots[0].psnr_db
    assert ("does not pay" in report.summary) == (gain < -0.1)


def test_the_verdict_names_gains_and_losses():
    levels = len(LIGHT_LEVELS)
    table = (("this code", (17.0, 20.0, 25.0, 30.0)), ("open shutter", (18.0, 20.05, 23.0, 25.0)))
    text = verdict(table)
    assert "gain at 10,000 (+2.00 dB), 100,000 (+5.00 dB)" in text
    assert "lose at 100 (-1.00 dB)" in text
    assert "1,000" not in text.replace("10,000", "").replace("100,000", "")
    same = (("this code", (20.0,) * levels), ("open shutter", (20.0,) * levels), ("snapshot", (21.0,) * levels))
    assert "less than 0.1 dB" in verdict(same)
    assert 'The "snapshot" is expected to do better than this code at 100 (+1.00 dB), 1,000 (+1.00 dB)' in verdict(same)
    assert "better than this code" not in text


def test_ones_own_photo_has_no_truth(chain):
    scene = own_photo("mine.jpg", chain.scene.photo, warnings=("The transparency was dropped.",))
    told = []
    mine = run_chain(
        scene, CAMERA, estimator=ReferenceEstimator(chain.scene.sharp), steps=1000, chips=12,
        tell=lambda share, _what: told.append(share),
    )  # fmt: skip
    assert (told[0], told[-1]) == (0, 1)
    assert told == sorted(told)
    assert [shot.name for shot in mine.shots] == ["open shutter", "coded"]
    page = html(demo_report(mine))
    assert "stands in for the scene" in page
    assert "The transparency was dropped." in page
    assert "true motion" not in page


def test_a_featureless_photo_is_refused():
    with pytest.raises(ValueError, match="black all over"):
        run_chain(own_photo("night.jpg", np.zeros((128, 128))), CAMERA)
