"""Photos of one motion, each through a code chosen by those before it."""

import numpy as np
import pytest

from cep.calibration import closed_loop
from cep.calibration.calibrate import Calibration
from cep.calibration.closed_loop import MOST_PHOTOS, calibrate_in_loop, calibration_steps
from cep.optics.camera import Camera
from cep.optics.capture import capture
from hw.device import load_profile
from hw.program import Program
from motdiff.estimators.base import MotionEstimate
from motdiff.files.trajectories import read_motion
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory


def bow():
    """Loop whose two directions through a crossing draw one blur."""
    t = np.linspace(0, 1, 80)
    angle = 2 * np.pi * t
    return Trajectory.from_samples(
        14 * np.stack([np.sin(angle), 0.7 * np.sin(2 * angle) + 0.4 * t], axis=1),
        direction="known",
    )


def camera_of(path, *, side_px=170, seed=0):
    """Take photos of one scene along a path."""
    rng = np.random.default_rng(seed)
    scene = np.kron(rng.random((side_px // 5, side_px // 5)), np.ones((5, 5)))
    camera = Camera(photons_full_scale=50_000)
    return lambda code: capture(scene, path, code, camera, rng=rng)


@pytest.fixture
def stated(monkeypatch):
    """Probabilities that the estimates state, one after the other; the path is the true one."""

    def state(probabilities, *, motion_blur=True):
        remaining = iter(probabilities)

        def estimate(photos, *, codes, seed, progress):
            assert (codes is None) == (len(photos) == 1)
            progress(1.0, "estimating")
            path = bow()
            probability = next(remaining)
            details = {"order_confidence": probability, "motion_blur": motion_blur}
            motion = MotionEstimate(
                "oracle", (path,), (1.0,), path.psf(64), probability, details=details
            )
            return Calibration.of(motion, np.asarray(photos[0]))

        monkeypatch.setattr(closed_loop, "estimate_motion", estimate)

    return state


def test_it_ends_when_the_order_is_sure(stated):
    stated([0.9, 0.6, 0.97, 0.99])
    steps = list(calibration_steps(camera_of(bow()), chips=24, chip_ns=5000))
    assert [len(step.photos) for step in steps] == [1, 2, 3]
    assert [step.is_sure for step in steps] == [False, False, True]
    codes = steps[-1].codes
    assert codes[0].bits == "1" * 24
    assert len({code.bits for code in codes}) == 3
    assert {(code.chips, code.chip_ns) for code in codes} == {(24, 5000)}
    assert steps[0].choice is None
    assert [step.choice.code for step in steps[1:]] == list(codes[1:])


def test_it_ends_after_the_most_photos(stated):
    stated([0.9] + [0.5] * 9)
    steps = list(calibration_steps(camera_of(bow()), chips=24, most_photos=3))
    assert [step.is_sure for step in steps] == [False, False, False]


def test_a_camera_at_rest_needs_no_other_photo(stated):
    stated([0.9], motion_blur=False)
    (step,) = calibration_steps(camera_of(bow()), chips=24)
    assert step.is_sure


def test_the_device_can_play_every_code(stated):
    stated([0.9, 0.5, 0.97])
    device = load_profile("mechanical")
    steps = list(calibration_steps(camera_of(bow()), chips=24, chip_ns=20_000_000, device=device))
    for code in steps[-1].codes:
        assert device.check(Program(code.bits, chip_ns=code.chip_ns)) == ()


def test_a_motion_shorter_than_what_counts_as_apart(stated, monkeypatch):
    """Its two directions are what is left to tell."""
    stated([0.9, 0.97])
    short = Trajectory.from_samples([[0, 0], [0.8, 0.1], [1.1, 0.9]], direction="known")
    monkeypatch.setitem(globals(), "bow", lambda: short)
    steps = list(calibration_steps(camera_of(short), chips=24))
    assert [step.is_sure for step in steps] == [False, True]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"most_photos": 0}, "most_photos: must be at least 1"),
        ({"chips": 3}, "chips: must be at least 4"),
        ({"device": "mechanical", "chip_ns": 10}, "mechanical"),
        ({"device": "led-strobe"}, "led-strobe cannot stay open for 52 ms"),
        ({"least_probability": 0.98}, "least_probability: must be within 0..0.97"),
    ],
)
def test_no_photo_is_taken_of_what_cannot_be(arguments, named):
    with pytest.raises(ValueError, match=named):
        next(calibration_steps(lambda _code: pytest.fail("a photo was taken"), **arguments))


def test_progress_of_each_step_only_grows(stated):
    stated([0.9, 0.97])
    shares = []
    for _ in calibration_steps(
        camera_of(bow()), chips=24, progress=lambda share, _: shares.append(share)
    ):
        assert shares == sorted(shares)
        assert min(shares) >= 0
        assert max(shares) <= 1
        shares.clear()


@pytest.mark.slow(reason="searches the motion in one, two and three photos")
def test_the_order_of_a_motion_is_found(short_search):
    """From photos whose codes were chosen by the estimates before. One search alone is never sure;
    notebooks/order_in_time.py has the whole of them."""
    # the kernel of the open photo is lost in 160 px
    *_, last = calibration_steps(camera_of(bow(), side_px=200), most_photos=3)
    assert timed_distance_px(last.calibration.best, bow()) < 0.7


def test_the_motion_is_written_after_each_photo(stated, tmp_path):
    stated([0.6, 0.97])
    shares = []
    steps, trajectory = calibrate_in_loop(
        camera_of(bow()),
        tmp_path / "motion",
        source=lambda step: {"codes": [code.bits for code in step.codes]},
        chips=24,
        progress=lambda share, note: shares.append((share, note)),
    )
    assert [step.is_sure for step in steps] == [False, True]
    stored = read_motion(trajectory)
    assert stored.source["codes"] == [code.bits for code in steps[-1].codes]
    assert [share for share, _ in shares] == sorted(share for share, _ in shares)
    assert shares[-1][1].startswith("photo 2: ")
    # a photo's share of the most that may be taken
    for number in (1, 2):
        begin = (number - 1) / MOST_PHOTOS
        within = [share for share, note in shares if note.startswith(f"photo {number}: ")]
        assert begin <= within[0] < within[-1] <= begin + 1 / MOST_PHOTOS


def test_photos_before_a_failure_leave_their_motion(stated, tmp_path, monkeypatch):
    stated([0.6])

    def broken(*_arguments, **_options):
        raise OSError("the cable is out")

    monkeypatch.setattr(closed_loop, "next_code", broken)
    with pytest.raises(OSError, match="cable"):
        calibrate_in_loop(camera_of(bow()), tmp_path / "motion", source=lambda _step: {}, chips=24)
    assert (tmp_path / "motion" / "trajectory.json").is_file()
