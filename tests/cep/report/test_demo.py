"""The whole chain, its files and its report, where coding pays and where it does not; on a small
scene."""

import json
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import typer

from cep.commands.main import app
from cep.files.files import read_code
from cep.files.images import read_photo
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.report.demo import DEMO_FILES, write_demo
from cep.report.demo_chain import CONTRAST, STANDARD_CAMERA, run_chain
from cep.report.demo_page import DEMO_PICTURES, demo_report, share_below_noise
from cep.report.demo_scene import FoundMotion, bundled_scene, find_motion, own_photo
from cep.report.result_page import html
from hw.device import load_profile
from hw.export import EXPORTERS
from motdiff.estimators.reference.estimator import ReferenceEstimator
from motdiff.files.trajectories import read_motion, stated_uncertainty_px
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory

LEVELS = (1000.0,)
CODED = Camera.load(STANDARD_CAMERA)
PLAIN = Camera.load(CONTRAST)
OF_A_CODE = {"code.json", "coded.png", "restored_coded.png", "code_strip.png"}


def small_scene(camera):
    return bundled_scene(camera, rng=np.random.default_rng(0), side_px=288)


def seen_once(scene):
    """What the photo alone tells, by the estimator that needs no luck."""
    return ReferenceEstimator(scene.sharp).estimate(scene.photo)


def chain_of(camera, **options):
    """Run the chain on a small part of the scene, from its open photo alone."""
    scene = small_scene(camera)
    return run_chain(scene, camera, found=FoundMotion(seen_once(scene)), levels=LEVELS, **options)


@pytest.fixture(scope="module")
def coded():
    return chain_of(CODED, chips=16)


@pytest.fixture(scope="module")
def plain():
    return chain_of(PLAIN, chips=16)


@pytest.fixture(scope="module")
def calibrated():
    """A chain whose motion photos through codes told."""
    scene = small_scene(CODED)
    known = replace(scene.motion, direction="known")
    alone = seen_once(scene)
    estimate = replace(
        alone,
        method="coded",
        trajectories=(known,),
        weights=(1.0,),
        details={"path_uncertainty_px": 0.2},
    )
    codes = tuple(ShutterCode(bits) for bits in ("1111", "0110"))
    found = FoundMotion(estimate, codes, (scene.photo, 0.5 * scene.photo), alone=alone)
    return run_chain(scene, CODED, found=found, levels=LEVELS, chips=16)


@pytest.fixture(scope="module", params=["coded", "plain", "calibrated"])
def either(request):
    return request.getfixturevalue(request.param)


class Page(HTMLParser):
    """Visible text, commands and images of a page."""

    def __init__(self, page):
        super().__init__()
        self.text = ""
        self.commands = ""
        self.images = []
        self.inside = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.images.append(dict(attrs))
        if tag in ("code", "script", "style"):
            self.inside.append(tag)

    def handle_endtag(self, tag):
        if self.inside and self.inside[-1] == tag:
            self.inside.pop()

    def handle_data(self, data):
        if "code" in self.inside:
            self.commands += data
        if not {"script", "style"} & set(self.inside):
            self.text += data


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
    assert coded.code == coded.advised_shot.way.code
    assert coded.shots[0].kind == "open"
    gains = coded.gains_db(known=True)
    assert gains["coded"] > max(gains["open"], gains.get("snapshot", 0.0))
    assert coded.contrast.choice == "snapshot"
    assert coded.contrast.here.camera == PLAIN


def test_where_it_does_not_the_snapshot_is_better(plain):
    assert plain.choice == "snapshot"
    assert (plain.code, plain.contrast, plain.alone) == (None, None, None)
    gains = plain.gains_db()
    assert gains["snapshot"] > max(gains["open"], gains["coded"])


def test_the_error_of_the_calibration_counts(calibrated, coded, tmp_path):
    """In the verdict of the page, and for who runs its commands on the motion that lies beside
    it."""
    assert coded.advice.path_error_px == 0
    assert calibrated.advice.path_error_px == calibrated.contrast.path_error_px == 0.2
    assert "a path known to 0.2 px" in calibrated.advice.sentence
    write_demo(tmp_path / "demo", calibrated)
    path = tmp_path / "demo" / "trajectory.json"
    assert stated_uncertainty_px(read_motion(path), path) == 0.2


def test_restoring_helps(either):
    for shot in either.shots:
        error = shot.photo.mean(axis=2) / shot.way.code.duty - either.reference.mean(axis=2)
        assert shot.psnr_db > -10 * np.log10(np.mean(error[30:-30, 30:-30] ** 2))


def test_no_code_outside_the_devices_limits():
    device = load_profile("mechanical-fast")
    chain = chain_of(PLAIN, chips=16, device=device, exposure_s=0.05)
    assert chain.problem.limits_runs
    assert all(chain.problem.allows(shot.way.code) for shot in chain.shots if shot.kind != "open")
    assert "mechanical-fast" in demo_report(chain).setting


def test_a_set_of_photos_tells_the_order(tmp_path):
    """The bundled motion is found from photos through codes, to a fraction of a pixel at equal
    times."""
    scene = small_scene(CODED)
    told = []
    found = find_motion(
        scene, CODED, exposure_s=0.03, tell=lambda share, _what: told.append(share)
    )
    assert told == sorted(told)
    assert len(found.codes) == len(found.photos) == 4
    assert found.codes[0].duty == 1
    assert found.estimate.best.direction == "known"
    assert timed_distance_px(found.estimate.best, scene.motion) < 0.5
    assert found.alone.best.direction == "unknown"


def test_no_set_through_a_device_that_cannot_play_it(coded, monkeypatch):
    monkeypatch.setattr(
        "cep.report.demo_scene.estimate_motion", lambda _photo, **_options: coded.estimate
    )
    found = find_motion(
        coded.scene, CODED, exposure_s=0.002, device=load_profile("mechanical-fast")
    )
    assert (found.codes, found.alone) == ((), None)


def test_knowing_the_order_is_worth_it(calibrated):
    # 0.2 to 0.5 dB: which of the good codes a search ends at hangs on the processor's last bits
    assert calibrated.advised_shot.psnr_db > calibrated.alone.psnr_db + 0.1


def test_ones_own_photo_has_no_truth(coded):
    scene = own_photo("mine.jpg", coded.scene.photo, warnings=("The transparency was dropped.",))
    told = []
    mine = run_chain(
        scene,
        CODED,
        found=coded.found,
        levels=LEVELS,
        chips=12,
        tell=lambda share, _what: told.append(share),
    )
    assert (told[0], told[-1]) == (0, 1)
    assert told == sorted(told)
    assert mine.gains_db(known=True) == {}
    page = html(demo_report(mine))
    assert "stands in for the scene" in page
    assert "The transparency was dropped." in page
    assert "The true motion is known" not in page


def test_a_featureless_photo_is_refused():
    with pytest.raises(ValueError, match=r"night\.jpg: .*black all over"):
        run_chain(own_photo("night.jpg", np.zeros((128, 128))), CODED)


def test_the_band_below_the_noise_grows_with_noise_and_blur():
    path = Trajectory.straight(20.0)
    still = Trajectory.straight(1.0)
    assert share_below_noise(still, None, PLAIN) < share_below_noise(path, None, PLAIN)
    assert share_below_noise(path, None, PLAIN) < share_below_noise(
        path, ShutterCode("1111"), CODED
    )


# -- files ----------------------------------------------------------------------------------------


def test_files_and_figures(coded, tmp_path):
    figures = write_demo(tmp_path / "out", coded)
    written = {item.name for item in (tmp_path / "out").iterdir()}
    of_a_set = {name for name in DEMO_FILES if name.startswith("calibration")}
    assert written == set(DEMO_FILES) - of_a_set - {
        "shutter_code.pulsepal.toml"
    }  # its ticks are 50 us
    stored = json.loads((tmp_path / "out/demo.json").read_text())
    assert stored["bits"] == coded.code.bits == figures["bits"]
    assert (stored["verdict"], stored["choice"]) == (coded.advice.here.sentence, "code")
    assert stored["gains_db"] == coded.advice.gains_db
    assert set(stored["psnr_db"]) == {"open", "snapshot", "coded"}
    assert read_code(tmp_path / "out/code.json").code == coded.code
    assert read_motion(tmp_path / "out/trajectory.json").trajectory.length_px == pytest.approx(
        coded.estimate.best.length_px
    )
    for name, suffix in (("c", ".h"), ("csv", ".csv"), ("json", ".json")):
        text = (tmp_path / "out" / f"shutter_code{suffix}").read_text()
        assert EXPORTERS[name].parse_back(text).bits == coded.code.bits
    assert read_photo(tmp_path / "out/coded.png").bits == 16
    for name in DEMO_PICTURES:
        assert (tmp_path / f"out/{name}.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="use --force"):
        write_demo(tmp_path / "out", coded)
    write_demo(tmp_path / "out", coded, force=True)


def test_files_of_a_set(calibrated, tmp_path):
    figures = write_demo(tmp_path, calibrated)
    assert figures["calibration_codes"] == ["1111", "0110"]
    assert figures["open_photo_alone"]["psnr_db"] == calibrated.alone.psnr_db
    assert {item.name for item in tmp_path.glob("calibration*")} == {"calibration_2.png"}
    write_demo(tmp_path, calibrated, force=True)


def test_no_code_is_written_where_none_is_advised(coded, plain, tmp_path):
    write_demo(tmp_path, coded)
    figures = write_demo(tmp_path, plain, force=True)  # the code of the first run goes
    names = {item.name for item in tmp_path.iterdir()}
    assert not OF_A_CODE & names
    assert not any(name.startswith("shutter_code") for name in names)
    assert figures["bits"] is None
    assert figures["choice"] == "snapshot"
    assert figures["psnr_db"]["coded"] == plain.shot("coded").psnr_db


# -- the page -------------------------------------------------------------------------------------


def test_the_page_recommends_no_code_where_none_is_advised(plain):
    report = demo_report(plain)
    page = Page(html(report))
    assert report.summary == plain.advice.here.sentence
    assert report.summary.startswith("Coding does not pay here")
    assert plain.shot("coded").way.code.bits not in page.text
    assert not re.search(
        r"cep (optimize|upload|export|calibrate blurred)|Code this exposure|Pulse the shutter",
        page.text,
    )
    assert "best code (not advised)" in page.text


def test_the_page_leads_with_the_verdict(coded):
    report = demo_report(coded)
    page = Page(html(report))
    assert report.summary == coded.advice.here.sentence
    assert coded.code.bits in page.text
    assert coded.contrast.sentence in page.text
    assert (
        page.text.index(report.setting)
        < page.text.index(report.summary)
        < page.text.index("Gain over the light")
    )


def test_figures_on_the_page_are_those_of_the_files(either, tmp_path):
    figures = write_demo(tmp_path, either)
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text.replace("−", "-")
    assert figures["verdict"] in text
    for psnr_db in figures["psnr_db"].values():
        assert psnr_db is None or f"{psnr_db:.2f}" in text
    advised = "coded" if figures["choice"] in ("code", "strobe") else figures["choice"]
    for kind, psnr_db in figures["psnr_db"].items():
        if psnr_db is not None and kind != advised:
            assert f"{figures['psnr_db'][advised] - psnr_db:+.1f} dB" in text
    for kind, gain in figures["gains_db"].items():
        if kind != "code" or gain != figures["gains_db"].get("strobe"):
            assert f"{gain:+.2f}" in text
    assert not re.search(r"\bnan\b|\binf\b", text)


def test_the_page_is_one_file_and_described(either):
    page = html(demo_report(either))
    images = Page(page).images
    assert len(images) >= 8
    assert all(
        image["alt"] and image["src"].startswith("data:image/png;base64,") for image in images
    )
    assert not re.search(
        r"""(?:src|href|srcset|action)="(?!data:image/png;|\#)|url\(|@import|https?:""", page
    )


def test_the_commands_on_the_page_take_their_options(either):
    commands = typer.main.get_command(app).commands
    lines = (
        Page(html(demo_report(either, options="--camera video-8bit --photons 100")))
        .commands.strip()
        .splitlines()
    )
    assert len(lines) >= 3
    for line in lines:
        program, name, *arguments = shlex.split(line)
        assert program == "cep"
        known = {option for parameter in commands[name].params for option in parameter.opts}
        assert {part for part in arguments if part.startswith("-")} <= known
