"""Diffusion over PSFs: what is diffused and back, the network without strides, training, and the
shipped weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lab.evaluation.floors import delta
from lab.evaluation.methods import named_estimators
from lab.rivals.psf_diffusion import PsfDiffusionEstimator, psf_signals, psfs_of_signals
from lab.trainings.rivals import PsfTrainer, psf_batch
from lab.weights import PSF_WEIGHTS
from motdiff.metrics import mnc_subpixel
from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import cosine_schedule
from motdiff.network.sampling import psfs_of_maps, sample_paths
from motdiff.simulate import blur_valid
from motdiff.training.batches import Batch
from motdiff.training.config import DataConfig, LossConfig, OptimiserConfig, TrainingConfig
from motdiff.training.run_piece import validation_mnc
from motdiff.training.weight_files import export_weights
from motdiff.trajectory import Trajectory
from motdiff.weights import DEFAULT_WEIGHTS, load_network, read_network_card

TINY = NetworkConfig(
    target="psf",
    backbone="none",
    physics_channels=2,
    physics_width=8,
    physics_depth=1,
    physics_patch=2,
    denoiser_width=16,
    decoder_widths=(8, 8),
    dropout=0.0,
    time_width=32,
)
BENT = Trajectory.from_samples([[0, 0], [9, 2], [14, 12]])


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def straight_batch(count=8):
    """HR maps of straight motions, told as they are."""
    motions = [Trajectory.straight(8 + 3 * i, angle_rad=0.5 * i) for i in range(count)]
    x0 = torch.from_numpy(np.stack([motion.hr_map() for motion in motions]).astype(np.float32))[
        :, None
    ]
    told = torch.nn.functional.avg_pool2d(x0, 4)
    return Batch(None, torch.cat([told, told], dim=1), x0, x0)


class Straight:
    def batch(self, step, size, *, rank=0):
        return straight_batch(size)


def config(*, steps=6, window=64, **optimiser):
    return TrainingConfig(
        DataConfig(photos="photos", physics_dropout=0.0),
        network=TINY,
        loss=LossConfig(path_weight=0, iou=0, stpd=0),
        optimiser=OptimiserConfig(
            steps=steps, batch=8, warm_up=5, ema=0.9, window=window, seed=2, **optimiser
        ),
    )


# ---- what is diffused


def test_signals_use_the_range_and_come_back():
    psfs = torch.from_numpy(np.stack([BENT.psf(), Trajectory.straight(17.3).psf()]))
    signals = psf_signals(psfs)
    assert signals.amax(dim=(1, 2)).tolist() == pytest.approx([1, 1])
    assert (signals[psfs > 0.02 * psfs.max()] > 0.14).all()
    torch.testing.assert_close(psfs_of_signals(signals), psfs)


def test_the_network_is_taught_the_psf_of_path_and_dwell():
    batch = straight_batch(2)
    taught = psf_batch(batch)
    assert taught.x0.shape == (2, 1, 64, 64)
    torch.testing.assert_close(taught.x0, psf_signals(psfs_of_maps(batch.dwell)))
    assert taught.physics is batch.physics
    for psf, motion in zip(
        psfs_of_signals(taught.x0[:, 0]).double().numpy(), (8, 11), strict=True
    ):
        truth = Trajectory.straight(motion, angle_rad=0.5 * (motion - 8) / 3).psf()
        assert mnc_subpixel(psf, truth) > 0.97


# ---- the network


def test_it_draws_on_the_grid_of_the_condition():
    network = MotDiffNetwork(TINY).eval()
    draw = torch.Generator().manual_seed(0)
    physics = torch.randn(2, 2, 64, 64, generator=draw)
    with torch.no_grad():
        condition = network.condition(None, physics)
        assert network.denoiser(
            torch.randn(2, 1, 64, 64, generator=draw), torch.tensor([3, 900]), condition
        ).shape == (
            2,
            1,
            64,
            64,
        )
        drawn = sample_paths(
            network, condition, count=3, schedule=cosine_schedule(), steps=2, generator=draw
        )
    assert drawn.path.shape == (2, 3, 64, 64)


def test_a_window_is_a_part_of_the_whole():
    """Away from its rim, which sees zeros instead of the rest."""
    network = MotDiffNetwork(TINY).eval()
    draw = torch.Generator().manual_seed(1)
    x_t = torch.randn(1, 1, 64, 64, generator=draw)
    physics = torch.randn(1, 2, 64, 64, generator=draw)
    t = torch.tensor([500])
    with torch.no_grad():
        whole = network(x_t, t, None, physics)
        part = network(x_t[..., 10:42, 20:52], t, None, physics, (10, 20))
    torch.testing.assert_close(
        part[..., 9:23, 9:23], whole[..., 19:33, 29:43], atol=1e-5, rtol=1e-4
    )


def test_the_map_s_weights_are_no_psf_s():
    with pytest.raises(ValueError, match="holds a network of target 'map', wanted 'psf'"):
        PsfDiffusionEstimator(weights=DEFAULT_WEIGHTS)
    with pytest.raises(ValueError, match="steps must be"):
        PsfDiffusionEstimator(steps=0)
    with pytest.raises(ValueError, match="dwell is True; it must be False for target 'psf'"):
        replace(TINY, dwell=True)


def test_the_number_of_steps_is_part_of_the_name(monkeypatch):
    made = []
    monkeypatch.setattr(
        "lab.rivals.psf_diffusion.PsfDiffusionEstimator", lambda **given: made.append(given)
    )
    assert list(named_estimators(["psf-diffusion", "psf-diffusion:3"])) == [
        "psf-diffusion",
        "psf-diffusion:3",
    ]
    assert made == [{}, {"steps": 3}]
    with pytest.raises(
        ValueError,
        match="method: must be psf-diffusion or psf-diffusion:STEPS, got 'psf-diffusion:ddim'",
    ):
        named_estimators(["psf-diffusion:ddim"])


# ---- training


def test_a_resumed_run_is_bit_equal(tmp_path):
    whole = PsfTrainer(config(window=24))
    straight_on = [whole.update(Straight()) for _ in range(4)]
    first = PsfTrainer(config(window=24))
    pieces = [first.update(Straight()) for _ in range(2)]
    first.save(tmp_path / "checkpoint")
    second = PsfTrainer(config(window=24))
    assert second.resume(tmp_path / "checkpoint")
    assert pieces + [second.update(Straight()) for _ in range(2)] == straight_on


def test_a_small_network_learns_psfs_that_it_is_told(tmp_path):
    trainer = PsfTrainer(config(steps=80, rate=1e-2))
    first = validation_mnc(trainer, (straight_batch(),))
    for _ in range(80):
        trainer.update(Straight())
    assert validation_mnc(trainer, (straight_batch(),)) > max(0.8, first)


def test_a_run_starts_from_the_condition_of_another(tmp_path):
    other = PsfTrainer(config())
    other.update(Straight())
    other.save(tmp_path / "checkpoint")
    file = tmp_path / "psf.safetensors"
    export_weights(tmp_path / "checkpoint", file)
    kept = load_network(file, target="psf").state_dict()
    begun = PsfTrainer(replace(config(start=str(file)), network=replace(TINY, denoiser_width=12)))
    begun.save(tmp_path / "begun")
    export_weights(tmp_path / "begun", tmp_path / "begun.safetensors")
    assert (
        read_network_card(tmp_path / "begun.safetensors")["config"]["optimiser"]["start"]
        == "psf.safetensors"
    )
    alone = replace(begun.config, optimiser=config().optimiser)
    fresh = PsfTrainer(alone).network.state_dict()
    for network in (begun.network, begun.average):
        for name, tensor in network.state_dict().items():
            assert torch.equal(tensor, (kept if name.startswith("physics.") else fresh)[name]), (
                name
            )
    wider = replace(config(start=str(file)), network=replace(TINY, physics_width=16))
    with pytest.raises(
        ValueError, match=r"psf.safetensors: its condition network has other sizes"
    ):
        PsfTrainer(wider)


# ---- the shipped weights


@pytest.fixture(scope="module")
def photo():
    from skimage import data

    return blur_valid(data.camera()[60:380, 100:420] / 255.0, BENT.psf(65))


def test_the_shipped_ones_say_what_they_are():
    assert PSF_WEIGHTS.stat().st_size <= 4 * 2**20
    card = read_network_card(PSF_WEIGHTS)
    assert card["config"]["network"]["target"] == "psf"
    readme = PSF_WEIGHTS.with_name("README.md").read_text(encoding="utf-8")
    assert f"{card['run']['steps']:,} updates" in readme.split("# psf_diffusion.safetensors")[1]


def test_they_draw_the_same_psf_for_a_seed_and_know_something(photo):
    found = PsfDiffusionEstimator(seed=1).estimate(photo)
    again, other = (PsfDiffusionEstimator(seed=seed).estimate(photo) for seed in (1, 2))
    np.testing.assert_array_equal(found.psf, again.psf)
    assert not np.array_equal(found.psf, other.psf)
    assert found.psf.min() >= 0
    assert found.psf.sum() == pytest.approx(1)
    at = np.arange(len(found.psf)) - len(found.psf) // 2
    assert max(abs(found.psf.sum(axis=axis) @ at) for axis in (0, 1)) <= 0.51
    assert found.details == {"steps": 1}
    for estimate in (found, other):
        assert mnc_subpixel(estimate.psf, BENT.psf()) > mnc_subpixel(delta(), BENT.psf()) + 0.2
    drawn = found.trajectories[0]
    assert mnc_subpixel(drawn.psf(max(64, drawn.frame_size())), found.psf) > 0.7
