"""The estimator with the diffusion model: an oracle for a network proves what is done around it;
real ones run."""

from functools import partial

import cv2
import numpy as np
import pytest
import torch
from skimage import data

from lab.evaluation.methods import NetworkAlone, named_estimators
from motdiff.blind_search.coarse_to_fine import Start
from motdiff.blind_search.grids import mirrored
from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge
from motdiff.estimators.motdiff import MotDiff, drawing
from motdiff.estimators.motdiff import estimator as module
from motdiff.estimators.motdiff.drawing import draw_psfs, quick_search
from motdiff.estimators.motdiff.estimator import (
    MotDiffEstimator,
    agreed_kernels,
    in_odd_frames,
    kernels_agreed_at_half,
)
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator, planned
from motdiff.metrics import mnc_subpixel
from motdiff.network.config import NetworkConfig
from motdiff.network.correction import corrected_kernel
from motdiff.network.physics_maps import QUICK_STARTS, autocorrelation, spectral_maps
from motdiff.network.sampling import psfs_of_maps
from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.progress import Progress
from motdiff.simulate import blur_valid, photograph
from motdiff.threads import one_thread
from motdiff.training.config import DataConfig, TrainingConfig
from motdiff.training.trainer import Trainer
from motdiff.training.weight_files import export_weights
from motdiff.trajectory import Trajectory
from motdiff.weights import MOTDIFF_FILES, load_correction

STRAIGHT = Trajectory.straight(15.0, angle_rad=0.5)
TINY = {
    "physics_channels": 2 + 2 * len(QUICK_STARTS),
    "physics_width": 8,
    "physics_depth": 1,
    "physics_patch": 2,
    "width": 8,
    "denoiser_width": 8,
    "decoder_widths": (8, 4),
    "dwell": True,
    "time_width": 16,
}
BENT = Trajectory.from_samples([[0, 0], [9, 2], [17, 8], [22, 17]])
LOST = (Trajectory.straight(9.0, angle_rad=2.2), Trajectory.straight(20.0, angle_rad=1.4))


@pytest.fixture(autouse=True)
def in_order():
    """One job after the other: the networks below note what they are asked."""
    with one_thread():
        yield


def bent():
    """No symmetry of its own, and a slow end."""
    t = np.linspace(0, 1, 50)
    return Trajectory.from_samples(np.c_[15.3 * t, 7.1 * np.sin(2.7 * t) + 3.3 * t], t=t**1.6)


def turned(motion, symmetry):
    """The path of the turned or mirrored photo."""
    xy = motion.xy * [-1 if symmetry & 2 else 1, -1 if symmetry & 1 else 1]
    return Trajectory(motion.t, xy[:, ::-1] if symmetry & 4 else xy)


def dead_leaves(height, width, *, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    image = np.full((height, width), 0.5)
    for _ in range(height * width // 60):
        radius = 3 / rng.uniform(0.05, 1)
        cx = rng.uniform(0, width)
        cy = rng.uniform(0, height)
        near = tuple(slice(max(0, int(c - radius)), int(c + radius) + 2) for c in (cy, cx))
        image[near][(x[near] - cx) ** 2 + (y[near] - cy) ** 2 < radius**2] = rng.uniform(
            0.05, 0.95
        )
    return image


def photo_of(motion, height=128, width=128, *, seed=0):
    sharp = dead_leaves(height + 32, width + 32, seed=seed)
    photo = blur_valid(sharp, motion.psf(33))
    return np.clip(photo + np.random.default_rng(seed).normal(0, 0.005, photo.shape), 0, 1)


# ---- networks


class Oracle:
    """Knows the motion in a photo, and how it lies when that photo is turned or mirrored."""

    physics = None
    photo = True
    pitch = 4
    denoiser = property(lambda network: network)

    def __init__(self, motion, *, logit=40.0, dwell=None):
        self.logit = logit
        self.dwell = dwell
        self.maps = [
            torch.from_numpy(turned(motion, symmetry).hr_map()).float() for symmetry in range(8)
        ]
        self.photos = []
        self.steps = []

    def condition(self, photo, physics):
        assert physics is None
        alike = [
            s
            for s in range(8)
            if self.photos and torch.equal(mirrored(self.photos[0], s, pitch=0), photo)
        ]
        self.photos = [*self.photos, photo] if alike else [photo]
        return torch.full((1, 1, 64, 64), float(alike[0] if alike else 0))

    def __call__(self, x_t, t, condition):
        (symmetry,) = {int(symmetry) for symmetry in condition[:, 0, 0, 0]}
        self.steps.append((symmetry, int(t[0]), len(x_t)))
        logits = self.logit * (2 * self.maps[symmetry].expand(len(x_t), 1, 256, 256) - 1)
        if self.dwell is None:
            return logits
        return torch.cat(
            [logits, torch.log(torch.expm1(self.dwell)).expand_as(logits)], dim=1
        )  # softplus undoes it


def estimator_with(monkeypatch, network, **options):
    monkeypatch.setattr(module, "load_network", lambda: network)
    return MotDiffEstimator(**options)


@pytest.fixture(scope="module")
def weights_of(tmp_path_factory):
    """Writes weights files of networks that were never trained."""

    def written(backbone):
        folder = tmp_path_factory.mktemp("run")
        config = TrainingConfig(
            DataConfig(photos="photos"), network=NetworkConfig(backbone=backbone, **TINY)
        )
        Trainer(config).save(folder / "checkpoint")
        export_weights(folder / "checkpoint", folder / "tiny.safetensors")
        return folder / "tiny.safetensors"

    return written


@pytest.fixture(scope="module")
def physics_only(weights_of):
    return weights_of("none")


CLOSED = "as training has them"  # the default


@pytest.fixture
def no_search(monkeypatch):
    """Make-believe classical kernels, where what is proved does not depend on them; notes what
    they are asked."""
    asked = []

    def made_up(photos, *, sigma, starts, fine_weights=CLOSED):
        asked.append((tuple(photos.shape), sigma, starts, fine_weights))
        kernels = torch.zeros(len(photos), len(starts), 64, 64)
        for i, start in enumerate(starts):
            kernels[:, i, 30, 27:38], kernels[:, i, 31:36, 27 + start.size // 20] = (
                1 / 16,
                1 / 16,
            )  # an L
        return kernels

    class NoPmp:
        def kernels(self, crops, *, progress, agreed=None):
            progress.spend(planned(len(STARTS)))
            made = made_up(torch.zeros(1, *crops.shape), sigma=None, starts=QUICK_STARTS)
            return list(made[0].double().numpy())

    for place in (drawing, module):
        monkeypatch.setattr(place, "quick_kernels", made_up)
    monkeypatch.setattr(module, "PmpEstimator", NoPmp)
    return asked


@pytest.fixture
def unrefined(monkeypatch):
    """Kernels stay as they are drawn or searched: nothing is refined or corrected."""
    monkeypatch.setattr(module, "agreed_kernels", lambda *_: None)
    monkeypatch.setattr(module, "refined", lambda _crops, kernel, _sigma: kernel)
    monkeypatch.setattr(
        module, "corrected_choice", lambda _network, _crops, candidates, **_: candidates
    )
    monkeypatch.setattr(module, "simple_motion", lambda *_, **__: None)


@pytest.fixture
def no_tracing(monkeypatch):
    """What a network that was never trained draws is no path, and long to trace."""
    for name in ("description.plain_trajectory", "description.simplest_trajectory"):
        monkeypatch.setattr(f"motdiff.estimators.{name}", lambda psf, **_: STRAIGHT)


# ---- drawing


def drawn_by(network, crops, *, told=None, count=1, steps=1, seed=0):
    told = np.zeros((0, 64, 64)) if told is None else told
    return draw_psfs(
        network,
        crops,
        told,
        count=count,
        steps=steps,
        generator=torch.Generator().manual_seed(seed),
    )


def test_every_turn_of_the_photo_is_undone():
    oracle = Oracle(bent())
    psfs = drawn_by(oracle, photo_of(bent(), 90, 110)[None], count=11, steps=3)
    assert len(oracle.photos) == 8  # once for each symmetry
    assert len({photo.numpy().tobytes() for photo in oracle.photos}) == 8
    assert oracle.steps == [(s, t, 2 if s < 3 else 1) for s in range(8) for t in (999, 666, 332)]
    expected = psfs_of_maps(torch.from_numpy(bent().hr_map()).double()).numpy()
    assert psfs.shape == (11, 64, 64)
    np.testing.assert_allclose(psfs, np.broadcast_to(expected, (11, 64, 64)), atol=1e-6)
    np.testing.assert_allclose(psfs.sum(axis=(1, 2)), 1, atol=1e-6)


def test_draws_are_weighted_by_their_dwell():
    dwell = torch.linspace(0.2, 3, 256).expand(256, 256)
    psfs = drawn_by(Oracle(bent(), dwell=dwell), photo_of(bent(), 90, 110)[None])
    expected = psfs_of_maps(torch.from_numpy(bent().hr_map()).double() * dwell)
    np.testing.assert_allclose(psfs[0], expected, atol=1e-6)


class Noise(Oracle):
    """Draws what it is given: the noise that each draw starts from."""

    def __call__(self, x_t, t, condition):
        return 10 * x_t


@pytest.mark.parametrize("count", [1, 9, 17])
def test_every_draw_starts_from_noise_of_its_own(count):
    crops = photo_of(bent(), 90, 110)[None]
    psfs = drawn_by(Noise(bent()), crops, count=count, steps=3)
    seen = [
        mirrored(torch.from_numpy(psf)[None, None], i % 8, pitch=1)[0, 0, 1:, 1:]
        for i, psf in enumerate(psfs)
    ]
    alike = np.atleast_2d(np.corrcoef([psf.numpy().ravel() for psf in seen]))
    assert np.abs(np.triu(alike, 1)).max() < 0.2
    for other, alike in (
        (drawn_by(Noise(bent()), crops, count=count, steps=3), True),
        (drawn_by(Noise(bent()), crops, count=count, steps=3, seed=1), False),
    ):
        assert np.array_equal(other, psfs) == alike


def test_one_draw_sees_the_photo_as_it_is():
    oracle = Oracle(bent())
    drawn_by(oracle, photo_of(bent(), 90, 110)[None])
    assert len(oracle.photos) == 1


def test_the_network_sees_the_best_crop_at_display_values():
    crops = np.random.default_rng(0).random((2, 300, 280))
    oracle = Oracle(STRAIGHT)
    drawn_by(oracle, crops)
    assert oracle.photos[0].shape == (1, 3, 256, 256)
    for channel in oracle.photos[0][0].double().numpy():
        np.testing.assert_allclose(channel**2.2, crops[0, 22:278, 12:268], atol=1e-6)


@pytest.mark.parametrize("shape", [(255, 256), (100, 140), (129, 48), (64, 65)])
def test_a_small_crop_is_mirrored_outwards(shape):
    crop = np.random.default_rng(0).random(shape)
    oracle = Oracle(STRAIGHT)
    drawn_by(oracle, crop[None])
    rows, columns = (
        np.abs((np.arange(256) + n - 1) % (2 * n - 2) - n + 1) for n in shape
    )  # 0 1 .. n-1 n-2 .. 1 0 1
    seen = oracle.photos[0][0, 0].double().numpy() ** 2.2
    np.testing.assert_allclose(seen, crop[rows][:, columns], atol=1e-6)


class Blind:
    """A network of physics maps alone; notes what it is shown."""

    physics = True
    photo = None
    pitch = 4
    denoiser = property(lambda network: network)

    def __init__(self):
        self.shown = []

    def condition(self, photo, physics):
        assert photo is None
        self.shown.append(physics)
        return torch.zeros(1, 1, 64, 64)

    def __call__(self, x_t, t, condition):
        return torch.zeros_like(x_t)


def test_physics_maps_turn_with_the_photo():
    """The turned photo's lags, the turned kernels, and those kernels' own autocorrelations."""
    crops = np.stack([photo_of(bent(), 96, 96, seed=seed) for seed in (0, 1)])
    told = np.stack([bent().psf(64), STRAIGHT.psf(64), np.roll(bent().psf(64), 5, axis=1)])
    network = Blind()
    drawn_by(network, crops, told=told, count=8)
    inner = (..., slice(1, None), slice(1, None))  # lag -32 has no partner
    assert len(network.shown) == 8
    for symmetry, maps in enumerate(network.shown):
        assert maps.shape == (1, 8, 64, 64)
        lags = spectral_maps(mirrored(torch.from_numpy(crops).float()[None], symmetry, pitch=0))
        torch.testing.assert_close(maps[:, :1][inner], lags[:, :1][inner], atol=1e-3, rtol=0)
        kernels = torch.from_numpy(told).float()[None]
        kernels = mirrored(kernels / kernels.amax(dim=(2, 3), keepdim=True), symmetry, pitch=1)
        torch.testing.assert_close(maps[:, 2:5], kernels)
        torch.testing.assert_close(
            maps[:, 5:][inner], autocorrelation(kernels)[inner], atol=1e-5, rtol=0
        )


def test_the_quick_searches_share_the_crops_and_their_noise(no_search):
    found = quick_search(np.random.default_rng(0).random((3, 80, 90)), sigma=0.02)
    assert found.shape == (3, 64, 64)
    assert sorted(no_search, key=lambda call: call[2][0].size) == [
        ((1, 3, 80, 90), 0.02, (start,), CLOSED)
        for start in sorted(QUICK_STARTS, key=lambda start: start.size)
    ]
    assert [int(np.argmax(kernel[33])) for kernel in found] == [
        27 + start.size // 20 for start in QUICK_STARTS
    ]


# ---- an oracle's motion is found


@pytest.fixture(scope="module")
def shaken():
    return photo_of(STRAIGHT)


def test_an_oracle_s_motion_is_found(monkeypatch, no_search, shaken):
    oracle = Oracle(STRAIGHT)
    estimate = estimator_with(monkeypatch, oracle).estimate(shaken)
    assert [(symmetry, draws) for symmetry, _, draws in oracle.steps] == [(s, 1) for s in range(8)]
    truth = STRAIGHT.psf(64)
    assert mnc_subpixel(estimate.psf, truth) > 0.98
    assert mnc_subpixel(estimate.trajectories[0].psf(), truth) > 0.95
    assert estimate.method == "motdiff"
    assert estimate.trajectories[0].direction == "unknown"
    assert estimate.confidence > 0.5
    assert estimate.warnings == ()
    assert estimate.psf.shape == (64, 64)
    assert estimate.psf.sum() == pytest.approx(1)
    assert estimate.psf.min() >= 0
    details = dict(estimate.details)
    assert details.pop("chosen") in ("sample", "mean of samples")
    assert details.pop("trajectory_psf_mnc") > 0.9
    assert details.pop("sample_agreement") == pytest.approx(1, abs=1e-3)
    assert details.pop("psf_confidence") == estimate.confidence
    assert details.pop("path_confidence") == pytest.approx(0.9 * estimate.confidence)
    assert details.pop("steep_edges") > 20
    assert details.pop("sharpest_edges_px") > 2
    assert details.pop("path_uncertainty_px", 0.1) < 0.5  # of a simple motion
    assert details == {"crops": 1, "scale": 1.0, "samples": 8, "classical": 3, "steps": 1}


def test_refinement_finds_the_dwell_that_the_network_does_not_know(
    monkeypatch, no_search, request
):
    """The map of a path says nothing of the time spent on it; the photo does."""
    photo = photo_of(bent(), 144, 144)
    truth = bent().psf(64)
    better = estimator_with(monkeypatch, Oracle(bent()), samples=1).estimate(photo)
    request.getfixturevalue("unrefined")
    drawn = estimator_with(monkeypatch, Oracle(bent()), samples=1).estimate(photo)
    assert 0.8 < mnc_subpixel(drawn.psf, truth) < 0.95
    assert mnc_subpixel(better.psf, truth) > 0.97


def test_what_a_network_is_nearly_sure_of_is_exactly_0(monkeypatch, no_search, unrefined):
    """Its probabilities never are; light all over the frame would be taken for a blur that
    outgrows it."""
    estimator = estimator_with(monkeypatch, Oracle(STRAIGHT, logit=6.0), samples=2)
    estimate = estimator.estimate(photo_of(STRAIGHT, 192, 192))
    assert {call[0] for call in no_search} == {(1, 1, 192, 192)}  # not once more at half size
    rows, columns = np.nonzero(estimate.psf)
    assert np.ptp(columns) < 20
    assert np.ptp(rows) < 15
    assert mnc_subpixel(estimate.psf, STRAIGHT.psf(64)) > 0.98


def test_candidates_come_in_odd_frames_with_their_zero_in_the_middle():
    psfs = np.zeros((2, 64, 64))
    psfs[0, 32, 32], psfs[0, 0, 5] = 0.75, 0.25  # what lies on the first row has no place
    psfs[1, 30, 36], psfs[1, 31, 36], psfs[1, 63, 63] = 0.98, 0.03, 0.01  # the last is doubt
    one, other = in_odd_frames(psfs)
    assert one.shape == other.shape == (63, 63)
    assert np.argwhere(one).tolist() == [[31, 31]]
    assert np.argwhere(other).tolist() == [[29, 35], [30, 35]]
    assert one.sum() == pytest.approx(1)
    assert other.sum() == pytest.approx(1)


def test_the_likeliest_different_kernels_are_corrected_and_the_photo_chooses(monkeypatch, shaken):
    """Kernel 3 was the likeliest, and 5 fits the photo once it is corrected; 0 and 1 were drawn, 4
    is like 3."""
    wrong = [Trajectory.straight(12.0, angle_rad=angle).psf(63) for angle in (1.0, 1.5, 2.0, 2.4)]
    kernels = tuple(wrong[i].copy() for i in (0, 0, 1, 2, 2, 3))
    found = FoundKernels(
        kernels, np.array([0.9, 0.8, 0.1, 0.7, 0.6, 0.3]), 3, {"steps": 1}, origins=tuple("abcdef")
    )
    told = []

    def noted(_network, crops, kernel, others, *, sigma):
        numbers = [
            next(i for i, one in enumerate(kernels) if one is other) for other in (kernel, *others)
        ]
        told.append(tuple(numbers))
        assert np.array_equal(crops, shaken[None])
        assert sigma == pytest.approx(noise_sigma(shaken))
        return STRAIGHT.psf(63) if numbers[0] == 5 else kernel

    monkeypatch.setattr(module, "corrected_kernel", noted)
    estimator = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=2)
    better = estimator.corrected(shaken[None], found, Progress())
    assert sorted(told) == [(2, 3, 4), (3, 4, 5), (5, 3, 4)]
    assert better.best == 5
    assert mnc_subpixel(better.kernels[5], STRAIGHT.psf(63)) > 0.99
    assert all(better.kernels[i] is kernels[i] for i in (0, 1, 4))
    assert better.confidence == 0.7
    assert sorted(better.probabilities[[2, 3, 5]]) == pytest.approx([0.1, 0.3, 0.7])
    assert better.probabilities[[0, 1, 4]] == pytest.approx(
        [0.9, 0.8, 0.0]
    )  # 4 is superseded by 3
    assert (better.details, better.origins) == (found.details, found.origins)


def test_a_correction_makes_no_kernel_likelier_than_the_best_was(monkeypatch, shaken):
    kernels = tuple(
        Trajectory.straight(12.0, angle_rad=angle).psf(63) for angle in (1.0, 1.5, 2.0, 2.4)
    )
    found = FoundKernels(kernels, np.array([0.0, 0.9, 0.4, 0.2]), 2)
    monkeypatch.setattr(
        module, "corrected_kernel", lambda _network, _crops, kernel, _others, **_: kernel
    )
    better = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=1).corrected(
        shaken[None], found, Progress()
    )
    assert better.confidence == 0.4
    assert sorted(better.probabilities[1:]) == pytest.approx([0.2, 0.4, 0.4])


def test_a_correction_keeps_the_sum_and_takes_kernels_of_any_frame(shaken):
    kernels = [STRAIGHT.psf(size) for size in (29, 63, 64)]
    found = corrected_kernel(load_correction(), shaken[None], kernels[0], kernels[1:], sigma=0.005)
    alone = corrected_kernel(
        load_correction(), shaken[None], kernels[0], kernels[1:2], sigma=0.005
    )
    assert found.shape == (63, 63)
    assert found.min() >= 0
    assert found.sum() == pytest.approx(1)
    assert mnc_subpixel(found, STRAIGHT.psf(64)) > 0.95
    np.testing.assert_allclose(alone, found, atol=1e-4)  # the other one stands for both


# ---- the network and the classical searches


class FakePmp:
    """Classical searches with known results, one per start, in frames as large as the photo lets
    them be."""

    motions = (STRAIGHT,) * len(STARTS)
    asked = 0

    def kernels(self, crops, *, progress, agreed=None):
        FakePmp.asked += 1
        progress.spend(planned(len(STARTS)) / 2)
        progress.spend(planned(len(STARTS)) / 2)
        return [motion.psf(start.size) for motion, start in zip(self.motions, STARTS, strict=True)]


@pytest.fixture
def classical(monkeypatch):
    monkeypatch.setattr(module, "PmpEstimator", FakePmp)
    monkeypatch.setattr(FakePmp, "asked", 0)

    def finds(*motions):
        monkeypatch.setattr(FakePmp, "motions", motions)

    return finds


class TwoThenFour(FakePmp):
    """Two searches, and two more where the first two have not agreed."""

    def kernels(self, crops, *, progress, agreed):
        kernels = super().kernels(crops, progress=progress)
        return kernels[:2] if agreed(kernels[:2]) else kernels


def test_where_two_corrected_searches_agree_nothing_more_is_searched_or_drawn(monkeypatch, shaken):
    monkeypatch.setattr(module, "PmpEstimator", TwoThenFour)
    monkeypatch.setattr(module, "draw_psfs", lambda *_, **__: pytest.fail("drew a motion"))
    estimator = estimator_with(monkeypatch, Oracle(STRAIGHT))
    candidates = estimator.search(shaken[None], Progress())
    better = estimator.corrected(shaken[None], candidates, Progress())
    assert len(candidates.kernels) == 2
    assert mnc_subpixel(candidates.kernels[0], STRAIGHT.psf(63)) > 0.99  # as searched
    pair = [STRAIGHT.psf(start.size) for start in STARTS[:2]]
    np.testing.assert_array_equal(
        better.kernels[1],
        corrected_kernel(
            load_correction(), shaken[None], pair[1], pair[:1], sigma=shared_sigma(shaken[None])
        ),
    )
    assert better.confidence == candidates.confidence > 0.9


def test_where_two_corrected_searches_differ_the_network_draws(monkeypatch, shaken):
    monkeypatch.setattr(module, "PmpEstimator", TwoThenFour)
    monkeypatch.setattr(FakePmp, "motions", (STRAIGHT, LOST[0], LOST[1], STRAIGHT))
    monkeypatch.setattr(
        module, "corrected_kernel", lambda _network, _crops, kernel, *_, **__: kernel
    )
    oracle = Oracle(STRAIGHT)
    candidates = estimator_with(monkeypatch, oracle).search(shaken[None], Progress())
    assert oracle.steps
    assert candidates.details["classical"] == len(STARTS)
    assert mnc_subpixel(candidates.best_kernel, STRAIGHT.psf(63)) > 0.9


def test_where_they_agree_at_half_the_size_nothing_more_is_searched_or_drawn(monkeypatch):
    photo = photo_of(STRAIGHT, 192, 192)
    halved = FoundKernels((STRAIGHT.psf(63),), np.array([0.97]), 0, corrected=(STRAIGHT.psf(63),))
    sizes = []

    def at_half(_network, _crops, _pair, small, **_):
        sizes.append(small.shape)
        return halved

    monkeypatch.setattr(module, "PmpEstimator", TwoThenFour)
    monkeypatch.setattr(FakePmp, "motions", (STRAIGHT, LOST[0], LOST[1], STRAIGHT))
    monkeypatch.setattr(module, "agreed_kernels", lambda *_: None)
    monkeypatch.setattr(module, "kernels_agreed_at_half", at_half)
    monkeypatch.setattr(module, "draw_psfs", lambda *_, **__: pytest.fail("drew a motion"))
    estimate = estimator_with(monkeypatch, Oracle(STRAIGHT)).estimate(photo)
    assert sizes == [(1, 96, 96)]
    assert estimate.details["scale"] == 1
    assert mnc_subpixel(estimate.psf, STRAIGHT.psf(64)) > 0.95


def test_a_classical_kernel_is_the_result_where_the_photo_believes_it_more(
    monkeypatch, classical, shaken
):
    classical(LOST[0], LOST[0], LOST[0], STRAIGHT)
    estimate = estimator_with(monkeypatch, Oracle(LOST[1]), samples=2).estimate(shaken)
    assert estimate.details["chosen"] == "classical"
    assert mnc_subpixel(estimate.psf, STRAIGHT.psf(64)) > 0.95
    assert estimate.details["classical"] == len(STARTS)
    assert estimate.method == "motdiff"


def test_the_network_s_motion_is_the_result_where_the_photo_believes_it_more(
    monkeypatch, classical, shaken
):
    classical(*[LOST[0]] * len(STARTS))
    estimate = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=2).estimate(shaken)
    assert estimate.details["chosen"] in ("sample", "mean of samples")
    assert mnc_subpixel(estimate.psf, STRAIGHT.psf(64)) > 0.95


def test_the_mean_of_the_draws_and_the_likeliest_classical_kernel_are_always_refined(
    monkeypatch, classical, shaken
):
    """The draws alone would fill all places: they are four, unlike, and believed more."""
    motions = [Trajectory.straight(16.0, angle_rad=angle) for angle in (0.3, 0.9, 1.5, 2.1)]
    classical(*LOST, *LOST)
    psfs = np.stack([motion.psf(64) for motion in motions])
    monkeypatch.setattr(module, "draw_psfs", lambda *_, **__: psfs)
    believed = np.r_[np.full(4, 0.9), 0.1, 0.3, 0.2, 0.2, 0.0]
    monkeypatch.setattr(
        module,
        "candidate_probabilities",
        lambda rows, *_, **__: np.r_[believed, np.arange(len(rows) - 9) / 10],
    )
    refined = []
    monkeypatch.setattr(
        module, "refined", lambda _crops, kernel, _sigma: refined.append(kernel) or kernel
    )
    monkeypatch.setattr("motdiff.threads.os.cpu_count", lambda: 1)  # one after the other
    found = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=4).search(
        shaken[None], Progress()
    )
    assert len(refined) == 3
    assert len(found.kernels) == 4 + 4 + 1 + 3
    assert mnc_subpixel(refined[0], LOST[1].psf(63)) > 0.99
    assert mnc_subpixel(refined[1], psfs.mean(axis=0)) > 0.99
    assert found.best == 11  # the last of the refined ones


def test_the_network_is_told_of_three_full_searches_smallest_frame_first(
    monkeypatch, classical, unrefined, shaken
):
    """As in its training: frames of 29, 39 and 53 px, of the photo as it is, zero displacement at
    index 32."""
    motions = [Trajectory.straight(float(i + 5), angle_rad=0.3) for i in range(len(STARTS))]
    classical(*motions)
    network = Blind()
    estimator_with(monkeypatch, network, samples=1).search(shaken[None], Progress())
    told = [(29, 0), (39, 0), (53, 0)]
    index = [
        [(start.size, start.quarter_turns) for start in STARTS].index(wanted) for wanted in told
    ]
    for kernel, i in zip(network.shown[0][0, 2:5].numpy(), index, strict=True):
        np.testing.assert_allclose(
            kernel, motions[i].psf(64) / motions[i].psf(64).max(), atol=1e-6
        )
    assert [start.size for start in QUICK_STARTS] == [29, 39, 53]


def test_where_the_first_two_searches_agree_the_larger_stands_for_the_third(
    monkeypatch, classical, unrefined, shaken
):
    monkeypatch.setattr(
        module.PmpEstimator, "kernels", lambda *_, **__: [STRAIGHT.psf(39), LOST[0].psf(53)]
    )
    network = Blind()
    found = estimator_with(monkeypatch, network, samples=1).search(shaken[None], Progress())
    assert found.details["classical"] == 2
    for kernel, told in zip(
        network.shown[0][0, 2:5].numpy(), (LOST[0], STRAIGHT, LOST[0]), strict=True
    ):
        np.testing.assert_allclose(kernel, told.psf(64) / told.psf(64).max(), atol=1e-6)


def test_the_real_searches_fit(monkeypatch, unrefined):
    """One start of each kind, on a small photo: their frames shrink with it."""
    monkeypatch.setattr(
        module, "PmpEstimator", partial(PmpEstimator, starts=(Start(21, sparsity=1.0), Start(99)))
    )
    network = Blind()
    found = estimator_with(monkeypatch, network, samples=1).search(
        photo_of(STRAIGHT, 64, 64)[None], Progress()
    )
    assert found.details["classical"] == 2
    assert network.shown[0].shape == (1, 8, 64, 64)
    assert np.ptp(np.nonzero(found.kernels[1]), axis=1).max() < 21
    assert all(kernel.sum() == pytest.approx(1) for kernel in found.kernels)


def test_kernels_that_the_photo_does_not_believe_are_said_to_be_lost(
    monkeypatch, classical, unrefined, shaken
):
    monkeypatch.setattr(
        module, "candidate_probabilities", lambda rows, *_, **__: np.full(len(rows), 0.3)
    )
    estimate = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=1).estimate(shaken)
    (lost,) = estimate.warnings
    assert lost.startswith("the blind estimate is probably lost (confidence 0.30)")
    assert estimate.confidence == 0.3


# ---- real networks, never trained


def test_the_same_photo_and_seed_give_the_same_estimate(physics_only, no_tracing, shaken):
    options = {"weights": physics_only, "samples": 2, "seed": 4}
    first, again = (MotDiffEstimator(**options).estimate(shaken[:72, :80]) for _ in range(2))
    np.testing.assert_array_equal(first.psf, again.psf)
    assert (first.confidence, first.details, first.weights) == (
        again.confidence,
        again.details,
        again.weights,
    )
    assert first.details["classical"] in (2, 4)


def test_another_seed_gives_other_draws(physics_only, no_search, unrefined, shaken):
    options = {"weights": physics_only, "samples": 3}
    one, same, other = (
        MotDiffEstimator(**options, seed=seed).search(shaken[None], Progress()).kernels[:3]
        for seed in (4, 4, 5)
    )
    for i in range(3):
        np.testing.assert_array_equal(one[i], same[i])
        assert np.abs(one[i] - other[i]).max() > 1e-3 * one[i].max()
        assert all(np.abs(one[i] - one[j]).max() > 1e-3 * one[i].max() for j in range(i))


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((100, 140), (1, 100, 140)),
        ((64, 64), (1, 64, 64)),
        ((256, 256), (1, 256, 256)),
        ((300, 300), (1, 300, 300)),
        ((500, 700), (3, 256, 256)),
    ],
)
def test_photos_of_any_size(physics_only, no_search, no_tracing, unrefined, shape, expected):
    estimate = MotDiffEstimator(weights=physics_only, samples=1).estimate(dead_leaves(*shape))
    assert no_search[0][0] == (1, *expected)
    assert estimate.psf.sum() == pytest.approx(1)
    assert np.isfinite(estimate.psf).all()
    if expected[0] == 1:
        assert estimate.details["crops"] == 1


def test_at_most_so_many_crops_as_asked_for(physics_only, no_search, no_tracing, unrefined):
    MotDiffEstimator(weights=physics_only, crops=2, samples=1).estimate(dead_leaves(500, 700))
    assert no_search[0][0] == (1, 2, 256, 256)


def test_a_network_of_photo_and_physics(weights_of, no_search, no_tracing, unrefined):
    weights = weights_of("b0")
    estimate = MotDiffEstimator(weights=weights, samples=1).estimate(dead_leaves(200, 300))
    assert estimate.details["classical"] == 3
    assert estimate.psf.sum() == pytest.approx(1)
    assert np.isfinite(estimate.psf).all()
    # of two photos with the same quick kernels it draws different paths
    one, other = (
        NetworkAlone(weights, steps=1).estimate(dead_leaves(64, 64, seed=seed)).psf
        for seed in (0, 1)
    )
    assert np.abs(one - other).max() > 5e-4 * one.max()


def test_each_crop_alone_is_searched_once(physics_only, no_search):
    estimator = MotDiffEstimator(weights=physics_only)
    crops = np.stack([photo_of(STRAIGHT, 80, 80, seed=seed) for seed in range(3)])
    found = FoundKernels((STRAIGHT.psf(63),), np.ones(1), 0)
    singles = estimator.single(crops, found, Progress())
    assert len(singles) == 3
    assert sorted(call[1] for call in no_search) == sorted(noise_sigma(crop) for crop in crops)
    assert {(call[0], *call[2:]) for call in no_search} == {((1, 1, 80, 80), QUICK_STARTS[:1], ())}
    assert all(single.sum() == pytest.approx(1) for single in singles)


# ---- options, refusals, progress


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (
            np.full((100, 100), 0.4),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (
            np.random.default_rng(0).random((63, 200)),
            "photo: needs at least 64 x 64 px, got 200 x 63",
        ),
        (np.full((100, 100), np.nan), "photo: must be finite, found NaN or infinity"),
        (np.zeros(5), "photo: must be (H, W) or (H, W, C), got shape (5,)"),
    ],
)
def test_unusable_photos_are_refused_in_one_line(monkeypatch, photo, message):
    oracle = Oracle(STRAIGHT)
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the whole message is compared
        estimator_with(monkeypatch, oracle).estimate(photo)
    assert str(caught.value) == message
    assert oracle.photos == []


@pytest.mark.parametrize("name", ["samples", "crops"])
def test_counts_must_be_positive(name):
    with pytest.raises(ValueError, match=f"^{name}: must be at least 1, got 0$"):
        MotDiffEstimator(weights="nowhere.safetensors", **{name: 0})


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.safetensors: cannot be read as weights"):
        MotDiffEstimator(weights=tmp_path / "none.safetensors")


def test_progress_rises_to_one(monkeypatch, classical, shaken):
    seen = []
    estimator = estimator_with(monkeypatch, Oracle(STRAIGHT), samples=1, progress=seen.append)
    for _ in range(2):  # of each photo from the start
        seen.clear()
        estimator.estimate(shaken)
        assert seen == sorted(seen)
        assert seen[-1] == 1
        assert len(set(seen)) == len(seen)
        assert np.diff([0, *seen]).max() < 0.5


# ---- the network alone, as the paper measures it


@pytest.fixture
def oracle_weights(monkeypatch):
    oracle = Oracle(bent())
    monkeypatch.setattr("motdiff.weights.load_network", lambda *path: oracle)
    return oracle


def test_the_network_alone_is_one_draw_as_it_is(oracle_weights, no_search):
    photo = photo_of(bent(), 100, 120)
    estimate = NetworkAlone(steps=3).estimate(photo)
    assert len(oracle_weights.photos) == 1
    assert no_search == []  # it takes no physics maps
    assert oracle_weights.steps == [(0, 999, 1), (0, 666, 1), (0, 332, 1)]
    np.testing.assert_allclose(
        estimate.psf, psfs_of_maps(torch.from_numpy(bent().hr_map()).double()), atol=1e-6
    )
    assert mnc_subpixel(estimate.trajectories[0].psf(), bent().psf(64)) > 0.85
    assert (estimate.method, estimate.weights, estimate.warnings) == ("network", (1.0,), ())
    colour = NetworkAlone(steps=3).estimate(np.repeat(photo[..., None], 3, axis=2))
    np.testing.assert_allclose(colour.psf, estimate.psf, atol=1e-6)


def test_the_network_alone_repeats_with_its_seed(physics_only, no_search, no_tracing, shaken):
    first, again, other = (
        NetworkAlone(physics_only, steps=2, seed=seed).estimate(shaken).psf for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3 * first.max()
    noisier = NetworkAlone(physics_only, sampler="ddpm", steps=2, seed=0).estimate(shaken).psf
    assert np.abs(first - noisier).max() > 1e-3 * first.max()


def test_several_draws_are_kept_and_the_first_is_the_estimate(
    physics_only, no_search, no_tracing, shaken
):
    (alone,) = named_estimators([f"network:ddim:2@{physics_only}"]).values()
    (many,) = named_estimators([f"network:ddim:2:3@{physics_only}"]).values()
    found = many.estimate(shaken)
    assert len(found.draws) == 3
    np.testing.assert_array_equal(found.psf, found.draws[0])
    np.testing.assert_allclose(found.psf, alone.estimate(shaken).psf, atol=1e-6)
    assert np.abs(found.draws[0] - found.draws[1]).max() > 1e-3 * found.psf.max()
    assert alone.estimate(shaken).draws == ()
    with pytest.raises(ValueError, match=r"^count: must be at least 1, got 0"):
        NetworkAlone(physics_only, count=0)


def test_draws_of_both_networks_are_those_of_the_first_corrected(
    physics_only, no_search, no_tracing, shaken
):
    (alone,) = named_estimators([f"network:ddim:2:3@{physics_only}"]).values()
    (both,) = named_estimators([f"networks:ddim:2:3@{physics_only}"]).values()
    drawn = alone.estimate(shaken)
    better = both.estimate(shaken)
    assert (drawn.method, better.method) == ("network", "networks")
    told = drawing.quick_search(shaken[None], sigma=noise_sigma(shaken))[:2]
    for psf, corrected in zip(drawn.draws, better.draws, strict=True):
        expected = corrected_kernel(
            load_correction(), shaken[None], psf, list(told), sigma=noise_sigma(shaken)
        )
        assert corrected.shape == (64, 64)
        np.testing.assert_allclose(corrected[1:, 1:], expected, atol=1e-6)
        assert np.abs(corrected - psf).max() > 0.05 * psf.max()
    np.testing.assert_array_equal(better.psf, better.draws[0])


def test_samplers_are_named_with_their_steps(oracle_weights, shaken):
    made = named_estimators(["network", "network:ddpm:4", "network:dpm++2m:2"])
    calls = {}
    for name, estimator in made.items():
        oracle_weights.steps.clear()
        estimator.estimate(shaken)
        calls[name] = len(oracle_weights.steps)
    assert calls == {"network": 1, "network:ddpm:4": 4, "network:dpm++2m:2": 2}
    with pytest.raises(ValueError, match="method must be one of ddpm, ddim, dpm"):
        named_estimators(["network:magic:2"])


@pytest.mark.parametrize(
    "name",
    [
        "network:ddpm",
        "network:ddpm:x",
        "network:ddpm:4:0",
        "network:ddpm:4:5:6",
        "networks:4",
        "motdiff:3",
        "pmp:1",
    ],
)
def test_other_names_are_refused(oracle_weights, name):
    with pytest.raises(
        ValueError,
        match=(
            r"^method: must be network, network:SAMPLER:STEPS or network:SAMPLER:STEPS:DRAWS, or"
            r" networks with"
        ),
    ):
        named_estimators([name])


def test_a_method_may_name_its_file_of_weights(oracle_weights, monkeypatch, tmp_path):
    taken = []
    monkeypatch.setattr(
        "lab.evaluation.methods.NetworkAlone", lambda weights, **_: taken.append(weights)
    )
    monkeypatch.setattr(
        "motdiff.estimators.motdiff.estimator.MotDiffEstimator",
        lambda *, weights, **_options: taken.append(weights),
    )
    file = tmp_path / "run 2.safetensors"
    file.touch()
    names = [f"network@{file}", f"network:ddpm:4@{file}", f"motdiff@{file}", "motdiff"]
    assert list(named_estimators(names)) == names
    assert taken == [file, file, file, None]
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors: no such file of weights"):
        named_estimators([f"network:ddim:1@{tmp_path / 'none.safetensors'}"])
    with pytest.raises(ValueError, match="method: must be one of"):
        named_estimators([f"pmp@{file}"])


def camera_photo(motion, *, side=256):
    rng = np.random.default_rng(0)
    scene = (data.camera()[60 : 60 + side + 64, 100 : 100 + side + 64] / 255) ** 2.2
    return photograph(scene, motion, rng=rng, read_sigma=0.005)[:side, :side]


def agreed_at_half(photo, pair):
    halved = cv2.resize(photo, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return kernels_agreed_at_half(
        load_correction(),
        photo[None],
        pair,
        halved[None],
        judge=Judge(photo[None]),
        progress=Progress(),
    )


@pytest.fixture(scope="module")
def blurred():
    return camera_photo(BENT)


def test_kernels_that_differ_are_not_agreed_on(blurred):
    pair = [motion.psf(63) for motion in LOST]
    assert agreed_kernels(load_correction(), blurred[None], pair, Judge(blurred[None])) is None


def test_what_searches_agree_on_at_half_the_size_is_the_motion_of_the_photo(blurred):
    candidates = agreed_at_half(blurred, [motion.psf(63) for motion in LOST])
    (kernel,) = candidates.corrected
    assert kernel.shape == (63, 63)
    assert kernel.sum() == pytest.approx(1)
    assert mnc_subpixel(kernel, BENT.psf(63)) > 0.9
    assert candidates.confidence > 0.9
    # enlarged alone it is coarser, and lies where it lay
    (searched,) = candidates.kernels
    assert 0.6 < mnc_subpixel(searched, BENT.psf(63)) < mnc_subpixel(kernel, BENT.psf(63))


def test_a_motion_that_outgrows_the_frame_is_left_to_the_photo_at_half_its_size():
    long = Trajectory.straight(84.0, angle_rad=0.3)
    assert agreed_at_half(camera_photo(long), [motion.psf(63) for motion in LOST]) is None


def test_weights_of_ones_own_take_the_place_of_the_shipped_network(tmp_path):
    shipped = MotDiff().weight_files()
    assert shipped == MOTDIFF_FILES
    assert len(shipped) == 2
    mine = tmp_path / "mine.safetensors"
    assert MotDiff(weights=mine).weight_files() == (mine, shipped[1])
