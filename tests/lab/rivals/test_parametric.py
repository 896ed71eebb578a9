"""Quadratic paths: closed forms of the best one, a network and a loss blind to direction, and the
shipped weights."""

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from lab.evaluation.floors import delta
from lab.evaluation.quadratic_limits import most_alike_quadratic, nearest_quadratic
from lab.rivals.parametric import ParametricEstimator, PathHead, PathNetwork, load_path_network
from lab.trainings import rivals
from lab.trainings.rivals import PathTrainer, path_loss, path_psfs
from lab.weights import PATH_WEIGHTS
from motdiff import __main__ as motdiff_commands
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi
from motdiff.network.config import NetworkConfig
from motdiff.simulate import blur_valid
from motdiff.tracing.quadratic import QuadraticPath
from motdiff.training.batches import Batch
from motdiff.training.config import DataConfig, OptimiserConfig, TrainingConfig
from motdiff.training.motion_bank import dwell_on_map
from motdiff.training.run_piece import validation_mnc
from motdiff.training.weight_files import export_weights
from motdiff.trajectory import Trajectory
from motdiff.weights import DEFAULT_WEIGHTS, load_network, read_network_card

TINY = NetworkConfig(
    target="path",
    backbone="none",
    physics_channels=2,
    physics_width=8,
    physics_depth=1,
    physics_patch=2,
)
PARABOLA = QuadraticPath([14.0, -6.0], [3.0, 25.0])
coefficient = st.floats(-20, 20, allow_nan=False)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def dwell_of(motion):
    hr_map = motion.hr_map()
    dwell = np.zeros(hr_map.shape, np.float32)
    dwell[hr_map > 0] = dwell_on_map(motion, hr_map)
    return torch.from_numpy(dwell)[None, None]


def coefficients(path):
    return torch.from_numpy(np.stack([path.a, path.b])[None]).float()


# ---- the class of paths


def test_a_path_is_the_polynomial_and_is_centred():
    motion = PARABOLA.trajectory(samples=2001)
    assert motion.at(1.0) - motion.at(0.0) == pytest.approx(PARABOLA.a, abs=1e-9)
    middle = motion.at(0.5)
    assert motion.at(0.0) + motion.at(1.0) - 2 * middle == pytest.approx(PARABOLA.b / 2, abs=1e-9)
    assert middle == pytest.approx(-PARABOLA.b / 12, abs=1e-5)
    backwards = QuadraticPath(-PARABOLA.a, PARABOLA.b).trajectory(samples=2001)
    np.testing.assert_allclose(backwards.xy, motion.xy[::-1], atol=1e-9)


@pytest.mark.parametrize(
    ("a", "b"), [([1.0, math.nan], [0, 0]), ([1.0, 2.0], [1.0]), ([[1.0, 2.0]], [0, 0])]
)
def test_what_is_no_path_is_refused(a, b):
    with pytest.raises(ValueError, match=r"^[ab]: must be two finite numbers \(x, y\), got "):
        QuadraticPath(a, b)


# ---- the oracle


def test_a_straight_motion_is_found_exactly():
    truth = Trajectory.straight(23.0, angle_rad=0.7)
    for found in (nearest_quadratic(truth), most_alike_quadratic(truth)):
        np.testing.assert_allclose(
            found.a, 23 * np.array([math.cos(0.7), math.sin(0.7)]), atol=1e-6
        )
        np.testing.assert_allclose(found.b, 0, atol=1e-6)


def test_a_parabola_is_found_exactly():
    truth = PARABOLA.trajectory(samples=8001)
    for found in (nearest_quadratic(truth), most_alike_quadratic(truth)):
        np.testing.assert_allclose(found.a, PARABOLA.a, atol=1e-6)
        np.testing.assert_allclose(found.b, PARABOLA.b, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 1), coefficient, coefficient), min_size=3, max_size=9))
def test_the_nearest_is_the_least_squares_solution(samples):
    """Against a dense numerical fit, for any path and pace; the reverse is nearest to the
    reverse."""
    steps, *xy = (np.array(column) for column in zip(*samples, strict=True))
    truth = Trajectory.from_samples(np.column_stack(xy), t=np.cumsum(steps))
    found = nearest_quadratic(truth)
    t = (np.arange(200_000) + 0.5) / 200_000
    shapes = np.column_stack([t - 0.5, (t - 0.5) ** 2 - 1 / 12])
    expected, *_ = np.linalg.lstsq(shapes, truth.at(t), rcond=None)
    np.testing.assert_allclose(np.stack([found.a, found.b]), expected, atol=1e-4)
    turned = nearest_quadratic(truth.reversed())
    np.testing.assert_allclose(turned.a, -found.a, atol=1e-9)
    np.testing.assert_allclose(turned.b, found.b, atol=1e-9)


def test_the_most_alike_is_a_limit_of_the_class():
    """Better than the nearest in time, and no search by another method from around it finds a
    better one."""
    truth = boracchi_foi(np.random.default_rng(3), max_length_px=45)
    psf = truth.psf()

    def alike(values):
        drawn = QuadraticPath(values[:2], values[2:]).trajectory()
        return mnc_subpixel(drawn.psf(max(64, drawn.frame_size())), psf)

    nearest = nearest_quadratic(truth)
    found = most_alike_quadratic(truth)
    assert alike(np.r_[found.a, found.b]) > alike(np.r_[nearest.a, nearest.b]) + 0.1
    assert found.a @ nearest.a >= 0
    climbed = optimize.minimize(
        lambda values: -alike(values),
        np.r_[found.a, found.b],
        method="Nelder-Mead",
        options={"maxfev": 150},
    )
    assert -climbed.fun < alike(np.r_[found.a, found.b]) + 0.03


# ---- the network and its loss


def test_the_head_gives_one_path_per_photo():
    network = PathNetwork(TINY)
    found = network(None, torch.randn(3, 2, 64, 64, generator=torch.Generator().manual_seed(0)))
    assert found.shape == (3, 2, 2)
    assert found.isfinite().all()


def test_the_head_predicts_the_square_of_the_drift():
    """Two opposite drifts are one output; a quarter turn of the output is an eighth of the
    drift."""
    head = PathHead(8)
    torch.nn.init.zeros_(head.output.weight)
    for turn_rad in (0.3, 0.3 + 2 * math.pi, 2.0):
        with torch.no_grad():
            head.output.bias.copy_(
                torch.tensor([math.cos(turn_rad), math.sin(turn_rad), 0.25, -0.5])
            )
            drift, bend = head(torch.zeros(1, 8, 64, 64))[0].numpy()
        assert np.hypot(*drift) == pytest.approx(16, rel=1e-4)
        assert math.tan(math.atan2(drift[1], drift[0])) == pytest.approx(
            math.tan(turn_rad / 2), rel=1e-4
        )
        np.testing.assert_allclose(bend, [4, -8], rtol=1e-6)


def test_rows_of_dots_are_the_psf():
    drawn = (
        path_psfs(coefficients(PARABOLA), torch.tensor([[2.0, -1.0]]), variance_px2=1 / 6)[0]
        .double()
        .numpy()
    )
    motion = PARABOLA.trajectory()
    assert mnc_subpixel(drawn, motion.psf()) > 0.99
    at = np.arange(64) - 32
    centre = [(drawn / drawn.sum()).sum(axis=axis) @ at for axis in (0, 1)]
    np.testing.assert_allclose(centre, [2.0, -1.0], atol=0.05)


def test_the_loss_is_least_at_the_truth_and_blind_to_direction():
    dwell = dwell_of(PARABOLA.trajectory())
    right = path_loss(coefficients(PARABOLA), dwell).item()
    assert right < 0.01
    assert path_loss(
        coefficients(QuadraticPath(-PARABOLA.a, PARABOLA.b)), dwell
    ).item() == pytest.approx(right, abs=1e-6)
    moved = torch.roll(dwell, (12, -20), (2, 3))
    assert path_loss(coefficients(PARABOLA), moved).item() == pytest.approx(right, abs=1e-4)
    for wrong in (QuadraticPath(PARABOLA.a, -PARABOLA.b), QuadraticPath([-6.0, 14.0], PARABOLA.b)):
        assert path_loss(coefficients(wrong), dwell).item() > right + 0.1


def test_the_loss_pulls_from_afar():
    dwell = dwell_of(PARABOLA.trajectory())
    values = coefficients(QuadraticPath([5.0, 3.0], [0.0, 0.0])).requires_grad_()
    optimiser = torch.optim.Adam([values], lr=1.0)
    losses = []
    for _ in range(80):
        optimiser.zero_grad()
        loss = path_loss(values, dwell)
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[0] > 0.15
    assert min(losses[-10:]) < 0.04


# ---- training


class Eight:
    """Maps of eight straight motions: what the photo says is the blurred truth."""

    def __init__(self):
        motions = [Trajectory.straight(8 + 2 * i, angle_rad=0.4 * i) for i in range(8)]
        dwell = torch.cat([dwell_of(motion) for motion in motions])
        told = torch.nn.functional.avg_pool2d(dwell, 4)
        self._batch = Batch(None, torch.cat([told, told], dim=1), (dwell > 0).float(), dwell)

    def batch(self, step, size, *, rank=0):
        return self._batch


def config(steps=6, **network):
    optimiser = OptimiserConfig(steps=steps, batch=8, rate=3e-3, warm_up=5, ema=0.9, seed=2)
    data = DataConfig(photos="photos", physics_dropout=0.05)
    return TrainingConfig(
        data, network=NetworkConfig(**{**asdict(TINY), **network}), optimiser=optimiser
    )


def test_a_resumed_run_is_bit_equal(tmp_path):
    whole = PathTrainer(config())
    straight_on = [whole.update(Eight()) for _ in range(4)]
    first = PathTrainer(config())
    pieces = [first.update(Eight()) for _ in range(2)]
    first.save(tmp_path / "checkpoint")
    second = PathTrainer(config())
    assert second.resume(tmp_path / "checkpoint")
    assert pieces + [second.update(Eight()) for _ in range(2)] == straight_on
    assert straight_on[-1].dwell == 0


def test_the_network_learns_paths_and_travels(tmp_path):
    trainer = PathTrainer(config(steps=60))
    losses = [trainer.update(Eight()).total for _ in range(60)]
    assert np.mean(losses[-5:]) < 0.5 * losses[0]
    (batch,) = Eight().batch(0, 8).split(8)
    assert validation_mnc(trainer, (batch,)) > 0.7
    trainer.save(tmp_path / "checkpoint")
    file = tmp_path / "path.safetensors"
    export_weights(tmp_path / "checkpoint", file)
    with torch.no_grad():
        expected = trainer.average(None, batch.physics)
    torch.testing.assert_close(
        load_path_network(file)(None, batch.physics), expected, atol=0.2, rtol=0.02
    )
    with pytest.raises(
        ValueError, match=r"path.safetensors: holds a network of target 'path', wanted 'map'$"
    ):
        load_network(file)
    with pytest.raises(
        ValueError, match=r"offset: must be 0 for weights without a denoiser, got 1\.5"
    ):
        export_weights(tmp_path / "checkpoint", file, offset=1.5)


def test_dwell_belongs_to_maps():
    with pytest.raises(ValueError, match="dwell is True; it must be False for target 'path'"):
        config(dwell=True)


# ---- the shipped weights


@pytest.fixture(scope="module")
def estimator():
    return ParametricEstimator()


@pytest.fixture(scope="module")
def photo():
    from skimage import data

    return blur_valid(data.camera()[60:380, 100:420] / 255.0, BENT.psf(65))


BENT = QuadraticPath([16.0, 7.0], [-6.0, 16.0]).trajectory()


def test_the_shipped_ones_say_what_they_are():
    assert PATH_WEIGHTS.stat().st_size <= 4 * 2**20
    card = read_network_card(PATH_WEIGHTS)
    assert card["config"]["network"]["target"] == "path"
    readme = PATH_WEIGHTS.with_name("README.md").read_text(encoding="utf-8")
    assert f"{card['run']['steps']:,} updates" in readme.split("# parametric.safetensors")[1]
    with pytest.raises(ValueError, match="holds a network of target 'map', wanted 'path'"):
        ParametricEstimator(weights=DEFAULT_WEIGHTS)


def test_they_find_a_bent_motion(estimator, photo):
    found = estimator.estimate(photo)
    truth = BENT.psf()
    assert mnc_subpixel(found.psf, truth) > mnc_subpixel(delta(), truth) + 0.2
    np.testing.assert_array_equal(found.psf, found.trajectories[0].psf(len(found.psf)))
    path = QuadraticPath(found.details["a_px"], found.details["b_px"])
    np.testing.assert_allclose(found.trajectories[0].xy, path.trajectory().xy, atol=1e-12)
    json.dumps(found.details)


def test_one_photo_one_path(estimator, photo):
    again = np.repeat(photo[..., None], 3, axis=2)
    np.testing.assert_allclose(
        estimator.estimate(again).psf, estimator.estimate(photo).psf, atol=1e-4
    )


def test_large_photos_are_looked_at_in_crops(estimator, photo):
    large = np.tile(photo, (2, 2))
    found = estimator.estimate(large[:500, :430])
    assert mnc_subpixel(found.psf, BENT.psf()) > mnc_subpixel(delta(), BENT.psf()) + 0.2


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (np.ones((256, 256)), "photo: is constant"),
        (np.eye(40), "photo: needs at least 64 x 64 px, got 40 x 40"),
        (np.full((80, 80), math.nan), "photo: must be finite"),
    ],
)
def test_photos_that_say_nothing_are_refused(estimator, bad, said):
    with pytest.raises(ValueError, match=said):
        estimator.estimate(bad)


def test_each_command_trains_its_targets(tmp_path, capsys):
    """``python -m motdiff`` trains maps alone, and the baselines' command their targets too."""
    file = tmp_path / "run.toml"
    config = Path(rivals.__file__).with_name("configs") / "parametric.toml"
    text = config.read_text(encoding="utf-8")
    file.write_text(text.replace("motdiff/weights/", f"{DEFAULT_WEIGHTS.parent}/"), "utf-8")
    command = ["train", str(file), "-o", str(tmp_path / "run"), "--device", "cpu"]
    assert motdiff_commands.run(command) == 2
    assert 'network.target: must be "map", got "path"' in capsys.readouterr().err
    assert rivals.run(command) == 2
    assert "data.prepared: samples: holds no prepared samples" in capsys.readouterr().err
