"""SelfDeblur fits what it says, can be stopped at any moment, and refuses what it cannot use."""

import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from dead_leaves import dead_leaves

from lab.evaluation.measure import measure_estimator
from lab.evaluation.methods import RIVALS, named_estimators
from lab.evaluation.sets import Case
from lab.rivals.selfdeblur import SelfDeblurConfig, SelfDeblurEstimator
from lab.rivals.selfdeblur import estimator as estimator_module
from lab.rivals.selfdeblur.fit import JointFit
from motdiff.metrics import mnc_subpixel
from motdiff.simulate import blur_valid

TINY = SelfDeblurConfig(
    kernel_px=9,
    iterations=300,
    structure_from=100,
    milestones=(200,),
    kernel_rate=3e-3,
    levels=3,
    channels=16,
    skip_channels=4,
    kernel_inputs=32,
    kernel_hidden=64,
)
QUICK = replace(TINY, iterations=6, structure_from=2, milestones=(3, 4), channels=8)
PSF = np.zeros((5, 5))
PSF[[0, 1, 2, 3, 4], [0, 1, 2, 2, 3]] = [0.3, 0.2, 0.2, 0.15, 0.15]


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


PHOTO = blur_valid(dead_leaves(52, 1), PSF)


def fit_of(config, photo=PHOTO):
    return JointFit(torch.from_numpy(photo.astype(np.float32)), config)


def stop_at(iteration, config):
    def progress(share):
        if round(share * config.iterations) == iteration:
            raise KeyboardInterrupt

    return progress


# ---- the fit


@pytest.mark.slow(reason="trains two networks on a photo")
def test_finds_the_blur_of_a_simulated_photo():
    """Of 48 x 48 px: from a flat kernel to the true one, the right way round, and what is returned
    is in convention."""
    delta = np.zeros((9, 9))
    delta[4, 4] = 1
    start = mnc_subpixel(fit_of(TINY).kernel().double().numpy(), PSF)
    assert start == pytest.approx(mnc_subpixel(np.ones((9, 9)), PSF), abs=0.03)
    estimate = SelfDeblurEstimator(config=TINY).estimate(PHOTO)
    found = mnc_subpixel(estimate.psf, PSF)
    assert found > max(start, mnc_subpixel(delta, PSF)) + 0.2
    assert found > mnc_subpixel(estimate.psf, PSF[::-1, ::-1]) + 0.02
    assert mnc_subpixel(estimate.trajectories[0].psf(), PSF) > 0.8
    assert (estimate.method, estimate.confidence, estimate.psf.shape) == (
        "selfdeblur",
        0.0,
        (64, 64),
    )
    assert estimate.psf.sum() == pytest.approx(1)
    y, x = np.mgrid[:64, :64] - 32
    assert max(abs((estimate.psf * x).sum()), abs((estimate.psf * y).sum())) <= 0.5
    assert estimate.details["iterations"] == 300
    assert 0 < estimate.details["loss"] < 0.05  # 1 - SSIM


def test_the_losses_come_in_the_published_order():
    """Mean squared error first, 1 - SSIM after: the second starts far above the first."""
    fit = fit_of(QUICK)
    losses = [fit.advance() for _ in range(4)]
    assert max(losses[:2]) < 0.2 < min(losses[2:])
    assert fit.iteration == 4


def test_after_a_milestone_the_rates_are_half(tmp_path):
    """What follows one is what follows from the same state at half the rates."""
    fit = fit_of(replace(QUICK, milestones=(2,)))
    fit.advance()
    fit.advance()
    fit.save(tmp_path / "state")
    halved = replace(
        QUICK, milestones=(), image_rate=QUICK.image_rate / 2, kernel_rate=QUICK.kernel_rate / 2
    )
    other = fit_of(halved)
    other.resume(tmp_path / "state")
    unhalved = fit_of(replace(QUICK, milestones=()))
    unhalved.resume(tmp_path / "state")
    here, there, without = ([each.advance() for _ in range(3)] for each in (fit, other, unhalved))
    assert here == there
    assert here[1:] != without[1:]


def test_the_seed_decides_everything():
    def run(seed):
        torch.rand(3)  # whatever else draws from the global generator
        fit = fit_of(replace(QUICK, seed=seed))
        return [fit.advance() for _ in range(3)]

    state = torch.get_rng_state()
    assert run(1) == run(1) != run(2)
    torch.rand(9)
    torch.set_rng_state(state)
    before = torch.rand(2)
    torch.set_rng_state(state)
    fit_of(QUICK).advance()
    assert torch.equal(torch.rand(2), before)  # and it leaves the global one alone


@pytest.mark.parametrize("shape", [(32, 57), (41, 33)])
def test_photos_of_any_shape_fit(shape):
    fit = fit_of(QUICK, dead_leaves(60, 2)[: shape[0], : shape[1]])
    assert all(np.isfinite(fit.advance()) for _ in range(3))
    assert fit.kernel().shape == (9, 9)


# ---- stopped and taken up again


@pytest.mark.parametrize("done", [0, 1, 3])
def test_a_resumed_fit_is_bit_equal(tmp_path, done):
    whole = fit_of(QUICK)
    straight_on = [whole.advance() for _ in range(6)]
    first = fit_of(QUICK)
    pieces = [first.advance() for _ in range(done)]
    first.save(tmp_path / "state")
    second = fit_of(QUICK)
    assert second.resume(tmp_path / "state") == 0.0
    assert second.iteration == done
    assert pieces + [second.advance() for _ in range(6 - done)] == straight_on
    assert torch.equal(second.kernel(), whole.kernel())


def test_a_stopped_estimate_goes_on_and_cleans_up(tmp_path):
    expected = SelfDeblurEstimator(config=QUICK).estimate(PHOTO)
    folder = tmp_path / "deep" / "states"
    options = {"config": QUICK, "checkpoints": folder, "saved_every_s": 0.0}
    with pytest.raises(KeyboardInterrupt):
        SelfDeblurEstimator(**options, progress=stop_at(4, QUICK)).estimate(PHOTO)
    with pytest.raises(KeyboardInterrupt):  # another photo and another recipe do not meet it
        SelfDeblurEstimator(**options, progress=stop_at(1, QUICK)).estimate(PHOTO[::-1])
    with pytest.raises(KeyboardInterrupt):
        SelfDeblurEstimator(
            **{**options, "config": replace(QUICK, seed=5)}, progress=stop_at(1, QUICK)
        ).estimate(PHOTO)
    assert len(list(folder.iterdir())) == 3
    seen = []
    again = SelfDeblurEstimator(**options, progress=seen.append).estimate(PHOTO)
    assert seen == [5 / 6, 1]
    np.testing.assert_array_equal(again.psf, expected.psf)
    assert expected.details["earlier_cpu_s"] == 0
    assert again.details == {**expected.details, "earlier_cpu_s": again.details["earlier_cpu_s"]}
    assert len(list(folder.iterdir())) == 2


def test_processor_time_before_a_stop_counts(tmp_path, monkeypatch):
    """With a clock that goes on 7 s after each save: all counts once, but for each stop's last 7
    s, not yet saved."""
    now = [0.0]
    monkeypatch.setattr(time, "process_time", lambda: now[0])

    def ticking(stop=None):
        def progress(share):
            now[0] += 7.0
            if stop is not None:
                stop_at(stop, QUICK)(share)

        return SelfDeblurEstimator(
            config=QUICK, checkpoints=tmp_path, saved_every_s=0.0, progress=progress
        )

    case = Case(PHOTO, np.pad(PSF, 2))
    for stop in (2, 5):
        with pytest.raises(KeyboardInterrupt):
            measure_estimator(case, ticking(stop), restore=False)
        now[0] += 1000.0  # another process
    # the save at iteration 2 has 7 s, that at iteration 5 two times 7 s more
    estimate = ticking().estimate(PHOTO)
    assert estimate.details["earlier_cpu_s"] == 7 + 14
    whole = measure_estimator(case, ticking(), restore=False).cpu_s
    assert whole == 6 * 7
    with pytest.raises(KeyboardInterrupt):
        ticking(4).estimate(PHOTO)
    assert measure_estimator(case, ticking(), restore=False).cpu_s == (3 + 2) * 7


def test_a_fit_of_another_code_is_not_taken_up(tmp_path, monkeypatch):
    options = {"config": QUICK, "checkpoints": tmp_path / "states", "saved_every_s": 0.0}
    with pytest.raises(KeyboardInterrupt):
        SelfDeblurEstimator(**options, progress=stop_at(3, QUICK)).estimate(PHOTO)
    changed = []
    for path in estimator_module._FITTING:
        (tmp_path / path.name).write_bytes(path.read_bytes())
        changed.append(tmp_path / path.name)
    monkeypatch.setattr(estimator_module, "_FITTING", tuple(changed))
    (tmp_path / "fit.py").write_text(
        (tmp_path / "fit.py").read_text().replace("_INPUT_SCALE = 0.1", "_INPUT_SCALE = 0.2")
    )
    seen = []
    SelfDeblurEstimator(**options, progress=seen.append).estimate(PHOTO)
    assert len(seen) == 6
    monkeypatch.undo()
    seen.clear()
    SelfDeblurEstimator(**options, progress=seen.append).estimate(PHOTO)
    assert len(seen) == 3


def test_nothing_is_written_within_the_first_minute(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        SelfDeblurEstimator(
            config=QUICK, checkpoints=tmp_path / "states", progress=stop_at(2, QUICK)
        ).estimate(PHOTO)
    assert not (tmp_path / "states").exists()


def test_a_spoilt_checkpoint_is_told_of(tmp_path):
    fit = fit_of(QUICK)
    assert fit.resume(tmp_path / "none") is None
    fit_of(replace(QUICK, channels=6)).save(tmp_path / "other")
    with pytest.raises(
        ValueError, match=r"other: its checkpoint belongs to generators of other sizes; remove it$"
    ):
        fit.resume(tmp_path / "other")
    fit.save(tmp_path / "cut")
    cut = tmp_path / "cut"
    cut.write_bytes(cut.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"cut: cannot be read as weights"):
        fit_of(QUICK).resume(tmp_path / "cut")


# ---- photos


def test_a_large_photo_is_fitted_in_its_best_crop(monkeypatch):
    sizes = []

    class Seen(JointFit):
        def __init__(self, photo, config):
            sizes.append(tuple(photo.shape))
            super().__init__(photo[:32, :32], config)

    monkeypatch.setattr("lab.rivals.selfdeblur.estimator.JointFit", Seen)
    estimator = SelfDeblurEstimator(config=replace(QUICK, iterations=1))
    light = np.random.default_rng(0).random((330, 300))
    for photo in (light, light[:320], np.repeat(light[:, :100, None], 3, axis=2)):
        estimator.estimate(photo)
    assert sizes == [(256, 256), (320, 300), (100, 100)]


@pytest.mark.parametrize(
    ("photo", "words"),
    [
        (
            np.full((100, 100), 0.4),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (
            np.random.default_rng(0).random((31, 300)),
            "photo: needs at least 32 x 32 px, got 300 x 31",
        ),
        (np.full((100, 100), np.nan), "photo: must be finite, found NaN or infinity"),
    ],
)
def test_unusable_photos_are_refused_in_one_line(photo, words):
    with pytest.raises(ValueError, match=f"^{words}$"):
        SelfDeblurEstimator(config=QUICK).estimate(photo)


# ---- by name


def test_slow_methods_are_there_by_name_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert {name for name, rival in RIVALS.items() if rival.reason} == {"selfdeblur", "blinddps"}
    made = named_estimators(["selfdeblur", "selfdeblur:2"])
    assert list(made) == ["selfdeblur", "selfdeblur:2"]
    assert made["selfdeblur"]._config == SelfDeblurConfig()
    assert made["selfdeblur:2"]._config == SelfDeblurConfig(iterations=2)
    assert made["selfdeblur"]._checkpoints == tmp_path / "motdiff" / "selfdeblur"
    with pytest.raises(
        ValueError, match="selfdeblur or selfdeblur:ITERATIONS, got 'selfdeblur:many'"
    ):
        named_estimators(["selfdeblur:many"])
