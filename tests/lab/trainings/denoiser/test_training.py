"""Training of the denoiser: samples, loss, schedule and command line."""

import itertools
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from cep.files.images import write_image
from cep.restoration.blur import Blur
from cep.restoration.denoiser.network import SCHEMA, DenoisingNetwork, load_denoiser
from cep.restoration.noise import fit_spectrum
from cep.restoration.plug_and_play import pnp
from lab.trainings.denoiser import samples
from lab.trainings.denoiser.__main__ import run
from lab.trainings.denoiser.samples import Photos
from lab.trainings.denoiser.training import DenoiserTrainer, Settings, scene_strength, train
from motdiff.photo_values import to_linear
from motdiff.training.photos import load_photos
from motdiff.weights_io import read_card

TINY = Settings(batch=2, crop_px=16, blurred_batch=2, blurred_px=72)


@pytest.fixture(scope="module")
def joined(photos):
    return Photos.joined(photos)


@pytest.fixture(scope="module")
def paths():
    """A straight motion of 12 px and an arc, (2, 64, 2)."""
    t = torch.linspace(-1, 1, 64)
    return torch.stack([torch.stack([6 * t, 0 * t], dim=1), torch.stack([9 * t, 4 * t**2], dim=1)])


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def clock(step_s):
    times = itertools.count(0.0, step_s)
    return lambda: next(times)


# ---- samples


def test_crops_lie_within_their_photo():
    """Photos of one value each: a crop across two photos would hold both."""
    even = [torch.full((3, 20 + i, 30 - i), 40 * i, dtype=torch.uint8) for i in range(5)]
    crops = Photos.joined(even).crops(200, 16, generator())
    assert (crops.amax(dim=(1, 2, 3)) == crops.amin(dim=(1, 2, 3))).all()
    values = to_linear(np.arange(5) * 40 / 255)
    np.testing.assert_allclose(np.unique(crops.numpy()), values, rtol=1e-5)


def test_crops_are_turned_and_mirrored(photos):
    one = Photos.joined([photos[0][:, :16, :16]])
    crops = one.crops(64, 16, generator()).numpy()
    assert len({crop.tobytes() for crop in crops}) == 8


def test_the_noise_is_white_and_of_the_level_told(joined):
    draw = generator()
    clean = samples.scenes(joined, 60, 32, draw)
    assert clean.shape == (60, 1, 32, 32)
    assert clean.min() >= 0
    assert clean.max() <= 1
    sigma = samples.levels(samples.SIGMAS, 60, draw)
    assert samples.SIGMAS[0] <= sigma.min() < 3 * samples.SIGMAS[0]
    assert samples.SIGMAS[1] / 3 < sigma.max() <= samples.SIGMAS[1]
    noise = samples.white_noise(clean, sigma, draw) / samples.column(sigma)
    assert float(noise.std()) == pytest.approx(1, abs=0.01)
    assert float((noise[..., 1:] * noise[..., :-1]).mean()) == pytest.approx(0, abs=0.02)


def test_psfs_hold_all_light_and_most_are_those_assumed(paths):
    psfs, assumed = samples.psfs(paths, 200, generator())
    for kernels in (psfs, assumed):
        assert kernels.min() >= 0
        torch.testing.assert_close(kernels.sum(dim=(1, 2)), torch.ones(200))
    same = (psfs - assumed).abs().amax(dim=(1, 2)) < 1e-6
    assert 0.6 < float(same.float().mean()) < 0.9


def test_an_open_shutter_s_otf_is_that_of_the_motion():
    """12 px of uniform straight motion along x: sinc(12 fx) through bilinear pixels, aliased."""
    side = 72
    t = torch.linspace(-6, 6, 4096)
    path = torch.stack([t, 0 * t])[None]
    H = samples.otfs(samples.splatted(path, torch.ones(1, 4096)), side)[0, 0].numpy()
    f = np.fft.rfftfreq(side) - np.arange(-20, 21)[:, None]
    expected = (np.sinc(12 * f) * np.sinc(f) ** 2).sum(axis=0)
    np.testing.assert_allclose(H[0], expected, atol=1e-3)


# ---- training


@pytest.mark.parametrize("progress", [0.0, 0.5])
def test_both_halves_lower_the_error_of_a_restored_photo(joined, paths, progress):
    trainer = DenoiserTrainer(joined, paths, replace(TINY, batch=4))
    scene = samples.scenes(joined, 4, 72, generator(5))
    sigma = torch.full((4,), 0.05)
    noisy = scene + samples.white_noise(scene, sigma, generator(6))
    H = samples.otfs(samples.psfs(paths, 4, generator(7))[0] * 0 + _point(), 72)

    def error():
        with torch.no_grad():
            restored = trainer.restored(noisy, H, sigma, scene_strength(scene))
        return float((restored - scene).square().mean())

    before = error()
    for _ in range(25):
        trainer.update(progress)
    assert error() < before


def _point():
    kernel = torch.zeros(64, 64)
    kernel[32, 32] = 1.0
    return kernel


def test_the_unrolled_restoration_is_that_of_the_package(joined, paths):
    """What is trained is what users get: the same photo, PSF and noise at periodic borders."""
    trainer = DenoiserTrainer(joined, paths, TINY)
    scene = samples.scenes(joined, 1, 80, generator(1))
    psf = samples.psfs(paths, 1, generator(2))[0]
    H = samples.otfs(psf, 80)
    photo = torch.fft.irfft2(H * torch.fft.rfft2(scene), (80, 80))
    photo = photo + samples.white_noise(photo, torch.tensor([0.02]), generator(3))
    image = photo[0, 0].double().numpy()
    kernel = psf[0].double().numpy()
    spectrum = fit_spectrum(image, Blur(kernel, image.shape, "periodic"), noise_variance=4e-4)
    strength = torch.tensor([spectrum.scene], dtype=torch.float32)

    def denoise(images, sigma):
        with torch.no_grad():
            return trainer.network(
                torch.from_numpy(images[:, None]).float(), torch.from_numpy(sigma).float()
            )[:, 0].numpy()

    with torch.no_grad():
        unrolled = trainer.restored(photo, H, torch.tensor([0.02]), strength)
    restored = pnp(image, kernel, noise_variance=4e-4, denoiser=denoise, border="periodic")
    np.testing.assert_allclose(unrolled[0, 0].numpy(), restored, atol=2e-4)


def test_the_step_size_ends_near_nothing(joined, paths):
    moved = []
    for progress in (0.3, 1.0):
        trainer = DenoiserTrainer(joined, paths, TINY)
        before = trainer.network.head.weight.detach().clone()
        trainer.update(progress)
        moved.append(float((trainer.network.head.weight.detach() - before).abs().max()))
    assert moved[1] == pytest.approx(0.01 * moved[0], rel=0.05)


def test_a_run_is_as_long_as_its_clock_says_and_writes_as_it_goes(joined, paths, tmp_path):
    target = tmp_path / "d.safetensors"
    lines = []
    steps = train(
        joined,
        paths,
        target,
        minutes=1.0,
        settings=TINY,
        save_s=25.0,
        clock=clock(10.0),
        report=lines.append,
    )
    assert steps == 6
    assert len(lines) == 2
    assert read_card(target, SCHEMA) == {"steps": 6, "seconds": 60, "settings": asdict(TINY)}
    again = tmp_path / "again.safetensors"
    train(joined, paths, again, minutes=1.0, settings=TINY, clock=clock(10.0))
    assert again.read_bytes() == target.read_bytes()


def test_what_is_written_is_the_average_of_the_weights(joined, paths, tmp_path):
    train(joined, paths, tmp_path / "d.safetensors", minutes=1.0, settings=TINY, clock=clock(20.0))
    trainer = DenoiserTrainer(joined, paths, TINY)
    average = trainer.network.head.weight.detach().clone()
    for step, old_share in enumerate((1 / 10, 2 / 11, 3 / 12)):
        trainer.update(step / 3)
        weights = trainer.network.head.weight.detach()
        average = old_share * average + (1 - old_share) * weights
    torch.testing.assert_close(trainer.average.head.weight, average)
    image = np.tile(np.random.default_rng(0).random((1, 16, 16)), (1, 3, 3))
    network = DenoisingNetwork()
    network.load_state_dict(trainer.average.state_dict())
    with torch.no_grad():
        expected = network(torch.from_numpy(image[None]).float(), torch.tensor([0.1]))[0].numpy()
    middle = (slice(None), slice(16, 32), slice(16, 32))  # one period
    denoise = load_denoiser(tmp_path / "d.safetensors")
    np.testing.assert_allclose(
        # which may be computed in bfloat16
        denoise(image[middle], np.array([0.1])),
        expected[middle],
        atol=1e-2,
    )


def test_the_command_packs_trains_and_evaluates(tmp_path, capsys):
    folder = tmp_path / "photos"
    folder.mkdir()
    write_image(folder / "a.png", np.random.default_rng(0).random((210, 230, 3)))
    pack, target = tmp_path / "photos.zip", tmp_path / "d.safetensors"
    assert run(["pack", str(folder), "-o", str(pack)]) == 0
    assert tuple(load_photos(pack, least_px=1)[0].shape) == (3, 131, 144)
    small = ("--minutes", "0.001", "--batch", "2", "--blurred-batch", "2")
    assert run(["train", str(pack), "-o", str(target), *small]) == 0
    assert read_card(target, SCHEMA)["steps"] >= 1
    assert run(["evaluate", str(folder), "--weights", str(target)]) == 0
    rows = re.findall(r"\| (-?[\d.]+) \| (-?[\d.]+) \|$", capsys.readouterr().out, re.MULTILINE)
    assert len(rows) == 36


# ---- bad input


def test_bad_input_gives_one_line(joined, paths, tmp_path, capsys):
    with pytest.raises(ValueError, match="minutes: must be above 0"):
        train(joined, paths, tmp_path / "d.safetensors", minutes=0.0)
    with pytest.raises(ValueError, match="photos: must be at least 200 px"):
        joined.crops(1, 200, generator())
    assert run(["train", str(tmp_path / "nowhere"), "-o", str(tmp_path / "d.safetensors")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())
