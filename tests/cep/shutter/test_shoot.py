"""A camera and a shutter together, on the twin: the real protocol on a pseudo-terminal."""

import importlib.util
import os
from dataclasses import replace

import numpy as np
import pytest
from emulators.tools import give_up, require_simavr

from cep.files.images import write_image
from cep.files.shot_files import ShotRecord, read_shot, record_beside, write_shot
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import played_psf
from cep.optics.timeline import timeline
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.shoot import open_rig, repeatability, shoot
from cep.shutter.twin import code_values
from hw.cameras.camera import Frame, FrameLostError
from hw.emulation.uno import CLOCK_HZ, EmulatedUno
from lab.studies.shoot_faults import FAULTS, run
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1011001110100110", 400_000)
PATH = Trajectory.straight(16.0, direction="known")
MOVING = ShotSettings(motion=PATH)
BY_SHUTTER = ShotSettings(release=Release.SHUTTER)


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    require_simavr()
    path = tmp_path_factory.mktemp("scene") / "scene.png"
    blocks = np.random.default_rng(0).uniform(0.1, 0.8, (12, 12))
    write_image(path, np.kron(blocks, np.ones((8, 8))), bits=16)
    return f"twin:scene={path}"


@pytest.mark.parametrize("release", [None, "shutter", "camera", "host"])
def test_a_photo_counts_and_is_that_of_the_pins(twin, release):
    with open_rig(twin) as rig:
        camera = rig.camera
        settings = ShotSettings(
            release=release and Release(release),
            motion=PATH,
            lead_in_s=0.05 if release == "host" else 0.001,
        )
        rig.prepare(CODE, settings)
        shot = rig.shoot()
        edges = camera.uno.edges()
    assert shot.counts
    assert shot.record.details["plays"] == 1
    assert shot.frame.values.dtype == np.uint16
    if release == "host":
        return  # when it plays is not the twin's to know
    # an oracle by the pins alone: the chips' bounds as they were, and the closed form of the PSF
    cycles = np.array([cycle for cycle, _level in edges])
    lead_s = shot.record.details["lead_in_ns"] * 1e-9
    pin = "trigger" if release == "camera" else "busy"
    trigger = next(cycle for cycle, level in camera.uno.edges(pin) if level)
    bounds = ((cycles - trigger) / CLOCK_HZ - lead_s) / (CODE.duration_ns * 1e-9)
    runs = ShutterCode("".join("10"[k % 2] for k in range(len(bounds) - 1)))
    psf = played_psf(timeline(PATH, bounds, None, code=runs), runs, (PATH.frame_size() | 1) + 2)
    clean = blur_valid(camera.scene.light, psf)
    assert camera.clean[1:-1, 1:-1] == pytest.approx(clean, abs=1e-9)
    # and the frame is the twin's own bits
    noise = camera.noise.with_dark_noise(shot.frame.exposure_s)
    rng = np.random.default_rng([0, 0])
    rng.standard_normal()  # the exposure's delay
    assert (code_values(noise, noise.expose(camera.clean, rng=rng)) == shot.frame.values).all()


@pytest.mark.parametrize(
    ("release", "words"), [("shutter", "cep hw timing"), ("host", "no wire"), ("camera", None)]
)
def test_what_is_trusted_is_said(twin, release, words):
    (shot,) = shoot(twin, CODE, settings=replace(MOVING, release=Release(release), lead_in_s=0.02))
    assert [words in warning for warning in shot.warnings] == ([True] if words else [])


def test_photos_of_a_series_are_counted_without_a_gap(twin):
    taken = []
    shots = shoot(twin, CODE, count=4, settings=MOVING, keep=taken.append)
    assert [shot.frame.frame_id for shot in shots] == [1, 2, 3, 4]
    assert tuple(taken) == shots
    assert all(shot.counts for shot in shots)
    alike = repeatability([shot.record.light(shot.frame.values) for shot in shots])
    assert alike.shift_px < 0.5
    assert alike.brightness_spread < 0.01
    assert 0 < alike.noise < 0.02


def test_the_machine_may_trigger(twin):
    shots = shoot(
        f"{twin},belt_hz=5", CODE, count=2, settings=replace(MOVING, release=Release.EXTERNAL)
    )
    assert [shot.record.details["plays"] for shot in shots] == [1, 1]


def test_without_a_trigger_nothing_is_taken_and_nothing_stays_armed(twin):
    with open_rig(twin) as rig:
        rig.prepare(CODE, ShotSettings(release=Release.EXTERNAL, wait_s=0.3))
        with pytest.raises(FrameLostError, match="no trigger came within"):
            rig.shoot()
        rig.camera.uno.trigger()
        assert rig.controller.status().state.name == "LOADED"
        assert rig.camera.uno.edges() == ()


def test_a_set_that_breaks_off_says_how_much_of_it_counts(twin):
    second_never_fits = ShutterCode(CODE.bits, 10**9)
    with pytest.raises(ValueError, match="exposes for") as caught:
        shoot(twin, [CODE, second_never_fits])
    assert caught.value.__notes__ == ["photos of 1 of 2 codes count"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exposure_s": 0.005}, r"exposure: 5 ms is shorter than the code with its lead-in, 7.62"),
        ({"exposure_s": 60}, "twin exposes for 1 us to 10 s"),
        ({"lead_in_s": 5}, "lead_in: must be a time within 0..1 s"),
        ({"lead_in_s": 0.9}, "code of .* chips is too long; at most 1024"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_armed(twin, options, words):
    with pytest.raises(ValueError, match=words):
        shoot(twin, CODE, settings=ShotSettings(**options))


def test_a_twin_has_its_own_port_and_a_photo_is_one_at_least(twin):
    with pytest.raises(ValueError, match="port: not valid with a twin"):
        shoot(twin, CODE, port="/dev/ttyS9")
    with pytest.raises(ValueError, match="count: must be at least 1"):
        shoot(twin, CODE, count=0)


def test_a_camera_needs_a_controller(tmp_path):
    with pytest.raises(ValueError, match="port: camera folder: needs a controller"):
        shoot(f"folder:{tmp_path}", CODE)


def test_a_folder_cannot_be_fired(tmp_path):
    require_simavr()
    with (
        EmulatedUno() as uno,
        pytest.raises(ValueError, match="cannot fire a camera folder:"),
    ):
        shoot(
            f"folder:{tmp_path}",
            CODE,
            port=uno.port,
            settings=ShotSettings(release=Release.CAMERA),
        )


def test_a_late_camera_loses_the_first_chips_and_the_lead_in_holds_them(twin):
    def mean(lead_in_s):
        settings = replace(MOVING, lead_in_s=lead_in_s)
        (shot,) = shoot(f"{twin},delay_us=3000", CODE, settings=settings)
        return shot.record.light(shot.frame.values).mean()

    # 3 ms late with 1 ms of lead-in: five chips are lost, of which three were open
    assert mean(0.001) / mean(0.0035) == pytest.approx(6.5 / 9, abs=0.06)


def test_a_measured_camera_is_waited_for(twin):
    profile = Camera(trigger_delay_s=3e-3, trigger_jitter_s=1e-5, readout_s=2e-3)
    measured = replace(MOVING, profile=profile)
    late = f"{twin},delay_us=3000,row_us=20"
    (shot,) = shoot(late, CODE, settings=measured)
    assert shot.warnings == ()
    assert shot.record.details["lead_in_ns"] >= 1e9 * profile.lead_in_s
    (prompt,) = shoot(f"{twin},delay_us=0", CODE, settings=MOVING)
    means = [taken.record.light(taken.frame.values).mean() for taken in (shot, prompt)]
    assert means[0] == pytest.approx(means[1], rel=0.005)
    with pytest.raises(ValueError, match="less than the camera's delay"):
        shoot(late, CODE, settings=replace(measured, lead_in_s=0.001))


def test_the_record_gives_the_light_back(twin, tmp_path):
    with open_rig(twin) as rig:
        rig.prepare(CODE, MOVING)
        shot = rig.shoot()
        clean = rig.camera.clean
    path = write_shot(tmp_path, "photo", shot.frame, shot.record, force=False)
    record = record_beside(path)
    assert record.code == CODE
    assert record.trajectory.xy.tolist() == PATH.xy.tolist()
    assert record.noise == shot.record.noise
    light = read_shot(path, record).pixels
    # noise of the model, 10000 electrons and 5 of read noise, and no offset
    error = light - clean
    assert abs(error.mean()) < 3e-4
    expected = np.sqrt(shot.record.noise.noise_variance(clean).mean())
    assert error.std() == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("release", [*Release, None])
def test_every_trigger_that_is_written_is_read(release, tmp_path):
    details = {"trigger": release and str(release)}
    frame = Frame(values=np.zeros((4, 4), dtype=np.uint8), bits=8, frame_id=1, camera="any")
    record = ShotRecord(code=CODE, bits=8, details=details)
    path = write_shot(tmp_path, "photo", frame, record, force=False)
    assert record_beside(path).code == CODE


def test_baslers_emulated_camera_exposes_while_the_emulated_shutter_plays():
    require_simavr()
    if importlib.util.find_spec("pypylon") is None:
        give_up("pypylon not installed: see .ci/tools")
    os.environ["PYLON_CAMEMU"] = "2"  # read once, by whichever test is the first
    # it has no lines that could be wired: this computer begins both
    settings = ShotSettings(release=Release.HOST, lead_in_s=0.02, exposure_s=0.2)
    with EmulatedUno() as uno:
        shots = shoot("pylon:0815-0000", CODE, port=uno.port, count=3, settings=settings)
        assert len(uno.edges()) == 3 * 2 * CODE.pulses
    assert [shot.record.problems for shot in shots] == [()] * 3
    assert [shot.record.details["plays"] for shot in shots] == [1] * 3
    assert shots[0].frame.exposure_s == pytest.approx(0.2)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_closes_the_shutter_and_keeps_what_was_taken(fault):
    require_simavr()
    outcome = run(fault, seed=1)
    assert outcome.passed, outcome
