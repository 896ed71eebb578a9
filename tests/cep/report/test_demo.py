"""The whole chain, its files and its report, where coding pays and where it does not; on a small
scene."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from cep.files.code_files import read_code, stored_device
from cep.files.images import read_photo
from cep.optics.camera import Camera
from cep.report.chain import STANDARD_CAMERA, run_chain
from cep.report.page import DEMO_FILES, PICTURE_FILES, html, write_demo
from cep.report.scene import Scene, bundled_scene, find_motion
from hw.device import DeviceProfile, load_profile
from hw.export import EXPORTERS
from motdiff.files.trajectories import read_motion, stated_uncertainty_px
from motdiff.metrics import timed_distance_px

LEVELS = (1000.0,)
CODED = Camera.load(STANDARD_CAMERA)
PLAIN = Camera.load("sony-imx250")
OF_A_CODE = {"code.json", "coded.png", "restored_coded.png", "code_strip.png"}


def small_scene(camera):
    return bundled_scene(camera, rng=np.random.default_rng(0), side_px=288)


def test_the_bundled_scene_repeats_and_moves():
    first, second = (
        bundled_scene(CODED, rng=np.random.default_rng(3), side_px=200) for _ in range(2)
    )
    np.testing.assert_array_equal(first.photo, second.photo)
    assert 20 < first.motion.length_px < 30
    assert first.photo.shape[0] < first.sharp.shape[0] == 200


# -- the chain ------------------------------------------------------------------------------------


def test_where_coding_pays_the_photos_show_it(coded):
    assert coded.choice == "code"
    assert coded.code == coded.advised_shot.exposure.code
    assert coded.shots[0].kind == "open"
    gains = coded.gains_db()
    assert gains["coded"] > max(gains["open"], gains.get("snapshot", 0.0))


def test_where_it_does_not_the_snapshot_is_better(plain):
    assert plain.choice == "snapshot"
    assert plain.code is None
    gains = plain.gains_db()
    assert gains["snapshot"] > max(gains["open"], gains["coded"])


@pytest.mark.slow  # the whole demo
def test_the_error_of_the_calibration_counts(calibrated, coded, demo_of):
    """In the verdict of the page, and for who runs its commands on the motion that lies beside
    it."""
    assert coded.advice.here.path_error_px == 0
    assert calibrated.advice.here.path_error_px == 0.2
    assert "a path known to 0.2 px" in calibrated.advice.sentence
    path = demo_of(calibrated)[0] / "trajectory.json"
    assert stated_uncertainty_px(read_motion(path), path) == 0.2


def test_restoring_helps(either):
    for shot in either.shots:
        error = shot.photo.mean(axis=2) / shot.exposure.code.duty - either.reference.mean(axis=2)
        assert shot.psnr_db > -10 * np.log10(np.mean(error[30:-30, 30:-30] ** 2))


def test_no_code_outside_the_devices_limits(plain):
    device = load_profile("mechanical-fast")
    chain = run_chain(
        plain.scene,
        PLAIN,
        motion=plain.motion,
        levels=LEVELS,
        chips=16,
        device=device,
        exposure_s=0.05,
    )
    assert chain.problem.limits_runs
    assert all(
        chain.problem.allows(shot.exposure.code) for shot in chain.shots if shot.kind != "open"
    )
    assert "mechanical-fast" in html(chain)


@pytest.mark.parametrize(
    ("limits", "kinds"),
    [({"max_pulses": 1}, ["open", "snapshot"]), ({"min_on_ns": 32_000_000}, ["open"])],
    ids=["opens once", "opens for all of it"],
)
def test_where_the_device_leaves_no_code_the_other_ways_are_shown(plain, limits, kinds):
    device = DeviceProfile(name="slow-shutter", tick_ns=1, max_chips=8, **limits)
    chain = run_chain(
        bundled_scene(PLAIN, rng=np.random.default_rng(0), side_px=128),
        PLAIN,
        motion=plain.motion,
        levels=LEVELS,
        device=device,
        exposure_s=0.032,
    )
    assert chain.problem.chips == 8
    assert [shot.kind for shot in chain.shots] == kinds
    assert chain.code is None


@pytest.mark.slow  # a calibration of four photos
def test_a_set_of_photos_tells_the_order(short_search):
    """The bundled motion is found from photos through codes, to a fraction of a pixel at equal
    times."""
    scene = small_scene(CODED)
    told = []
    found = find_motion(
        scene, CODED, exposure_s=0.03, progress=lambda share, _what: told.append(share)
    )
    assert told == sorted(told)
    assert len(found.codes) == len(found.photos) == 4
    assert found.codes[0].duty == 1
    assert found.estimate.best.direction == "known"
    assert timed_distance_px(found.estimate.best, scene.motion) < 0.5


def test_the_photos_of_a_set_are_searched_on_the_same_crop(monkeypatch):
    crops = []
    monkeypatch.setattr("cep.estimate_motion", lambda photos, **_options: crops.extend(photos))
    scene = small_scene(CODED)
    motion = find_motion(scene, CODED, exposure_s=0.03)
    photos = motion.photos
    for code in motion.codes:  # each lasts as long as the exposure, whatever its chips
        assert code.chips * code.chip_ns == pytest.approx(0.03e9, abs=code.chips)
    assert {crop.shape for crop in crops} == {(192, 192, 3)}
    height, width = np.subtract(scene.photo.shape[:2], 191)
    places = [
        {
            (row, column)
            for row in range(height)
            for column in range(width)
            if np.array_equal(photo[row, column], crop[0, 0])
            and np.array_equal(photo[row : row + 192, column : column + 192], crop)
        }
        for photo, crop in zip(photos, crops, strict=True)
    ]
    assert len(places) == 4
    assert len(set.intersection(*places)) == 1


def test_no_set_through_a_device_that_cannot_play_it(coded, monkeypatch):
    monkeypatch.setattr("cep.estimate_motion", lambda _photo, **_options: coded.estimate)
    found = find_motion(
        coded.scene, CODED, exposure_s=0.002, device=load_profile("mechanical-fast")
    )
    assert found.codes == ()


@pytest.mark.slow  # a blind calibration
def test_ones_own_photo_has_no_truth(coded):
    scene = Scene("mine.jpg", coded.scene.photo, warnings=("The transparency was dropped.",))
    told = []
    mine = run_chain(
        scene,
        CODED,
        motion=coded.motion,
        levels=LEVELS,
        chips=12,
        progress=lambda share, _what: told.append(share),
    )
    assert (told[0], told[-1]) == (0, 1)
    assert told == sorted(told)
    page = html(mine)
    assert "stands in for the scene" in page
    assert "The transparency was dropped." in page
    assert "The true motion is known" not in page
    # the photo itself comes first, then what was simulated of it, named so
    first, last = (page.index(title) for title in ("Your photo, sharpened", "Simulated photos"))
    assert first < page.index(mine.advice.here.sentence.partition(";")[0]) < last
    assert "Blurred</h3>" not in page
    assert mine.sharpened.method is not None
    doubtful = replace(mine.motion.estimate, confidence=0.2)
    lost = replace(mine, motion=replace(mine.motion, estimate=doubtful))
    assert lost.verdict.startswith("The motion of this photo was probably not found")
    assert "probably not found" not in mine.verdict
    gain = f"{mine.gains_db()[mine.advised_shot.kind]:+.1f} dB over the open shutter"
    assert (gain in mine.verdict) == (mine.choice != "open")


def test_a_verdict_of_the_bundled_photo_stands_alone(coded):
    assert coded.sharpened is None
    assert coded.verdict == coded.advice.here.sentence


def test_a_featureless_photo_is_refused():
    with pytest.raises(ValueError, match=r"night\.jpg: .*black all over"):
        run_chain(Scene("night.jpg", np.zeros((128, 128))), CODED)


# -- files ----------------------------------------------------------------------------------------


@pytest.mark.slow  # the whole demo
def test_files_and_figures(coded, demo_of):
    folder, figures = demo_of(coded)
    written = {item.name for item in folder.iterdir()}
    of_a_set = {name for name in DEMO_FILES if name.startswith("calibration")}
    assert written == set(DEMO_FILES) - of_a_set - {
        "shutter_code.pulsepal.toml"
    }  # its ticks are 50 us
    stored = json.loads((folder / "demo.json").read_text())
    assert stored["bits"] == coded.code.bits == figures["bits"]
    assert (stored["verdict"], stored["choice"]) == (coded.advice.here.sentence, "code")
    assert stored["gains_db"] == coded.advice.gains_db
    assert set(stored["psnr_db"]) == {"open", "snapshot", "coded"}
    assert read_code(folder / "code.json").code == coded.code
    assert read_motion(folder / "trajectory.json").trajectory.length_px == pytest.approx(
        coded.estimate.best.length_px
    )
    for name, suffix in (("c", ".h"), ("csv", ".csv"), ("json", ".json")):
        text = (folder / f"shutter_code{suffix}").read_text()
        assert EXPORTERS[name].parse_back(text).bits == coded.code.bits
    assert read_photo(folder / "coded.png").bits == 16
    for name in PICTURE_FILES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="use --force"):
        write_demo(folder, coded)


def test_the_code_is_kept_with_its_shutter(coded, monkeypatch, tmp_path):
    """With all limits of a profile of one's own, which has no other file there."""
    own = DeviceProfile(name="own-shutter", tick_ns=125, min_on_ns=1000)
    # they take most of the time
    monkeypatch.setattr("cep.report.page.pictures", lambda chain: {})
    monkeypatch.setattr("cep.report.page.html", lambda *_chain, **_options: "")
    write_demo(tmp_path / "out", replace(coded, device=own))
    stored = read_code(tmp_path / "out" / "code.json")
    assert stored_device(stored, source="code.json") == own


@pytest.mark.slow  # the whole demo of a set
def test_files_of_a_set(calibrated, demo_of):
    folder, figures = demo_of(calibrated)
    assert figures["calibration_codes"] == ["1111", "0110"]
    assert {item.name for item in folder.glob("calibration*")} == {"calibration_2.png"}


@pytest.mark.slow  # the whole demo
def test_no_code_is_written_where_none_is_advised(coded, plain, demo_of, tmp_path):
    shutil.copytree(demo_of(coded)[0], tmp_path / "out")
    figures = write_demo(tmp_path / "out", plain, force=True)  # the code of the first run goes
    names = {item.name for item in (tmp_path / "out").iterdir()}
    assert not OF_A_CODE & names
    assert not any(name.startswith("shutter_code") for name in names)
    assert figures["bits"] is None
    assert figures["choice"] == "snapshot"
    assert figures["psnr_db"]["coded"] == plain.shot("coded").psnr_db
