"""Draws of the paper's network, alone and corrected: an oracle for a network proves what is done
around it; real ones run."""

import numpy as np
import pytest
import torch
from leaf_photos import leaves, photo_of

from lab.evaluation.methods import NetworkAlone, named_estimators
from motdiff.blind_search.grids import mirrored
from motdiff.estimators.motdiff import drawing
from motdiff.estimators.motdiff.drawing import draw_psfs, quick_search
from motdiff.metrics import mnc_subpixel
from motdiff.network.config import NetworkConfig
from motdiff.network.correction import corrected_kernel
from motdiff.network.physics_maps import QUICK_STARTS, autocorrelation, spectral_maps
from motdiff.network.sampling import psfs_of_maps
from motdiff.photo_noise import noise_sigma
from motdiff.threads import one_thread
from motdiff.training.config import DataConfig, TrainingConfig
from motdiff.training.trainer import Trainer
from motdiff.training.weight_files import export_weights
from motdiff.trajectory import Trajectory
from motdiff.weights import load_correction

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

    monkeypatch.setattr(drawing, "quick_kernels", made_up)
    return asked


@pytest.fixture
def no_tracing(monkeypatch):
    """What a network that was never trained draws is no path, and long to trace."""
    for name in ("description.plain_trajectory", "description.simplest_trajectory"):
        monkeypatch.setattr(f"motdiff.estimators.{name}", lambda psf, **_: STRAIGHT)


@pytest.fixture(scope="module")
def shaken():
    return photo_of(STRAIGHT)


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
    file = tmp_path / "run 2.safetensors"
    file.touch()
    names = [f"network@{file}", f"network:ddpm:4@{file}", "network"]
    assert list(named_estimators(names)) == names
    assert taken == [file, file, None]
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors: no such file of weights"):
        named_estimators([f"network:ddim:1@{tmp_path / 'none.safetensors'}"])
    with pytest.raises(ValueError, match="method: must be one of"):
        named_estimators([f"motdiff@{file}"])


def test_a_network_of_photo_and_physics_sees_the_photo(weights_of, no_search, no_tracing):
    weights = weights_of("b0")
    # of two photos with the same quick kernels it draws different paths
    one, other = (
        NetworkAlone(weights, steps=1).estimate(leaves(64, 64, seed=seed)).psf for seed in (0, 1)
    )
    assert np.abs(one - other).max() > 5e-4 * one.max()
