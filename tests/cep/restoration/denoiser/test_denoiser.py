"""The denoiser of the plug-and-play restoration: network, weights files, and the shipped
weights."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from skimage import data

from cep.restoration.denoiser import network as denoiser
from cep.restoration.denoiser.network import SCHEMA, SHIPPED, DenoisingNetwork, load_denoiser
from motdiff.photo_values import to_linear
from motdiff.weights_io import halved, read_card


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def psnr(a, b):
    return -10 * np.log10(np.mean((a - b) ** 2))


# ---- network


def test_image_and_noise_level_scale_together():
    torch.manual_seed(0)
    network = DenoisingNetwork((4, 6, 8))
    images = torch.rand(2, 1, 13, 18)
    sigma = torch.tensor([0.1, 0.02])
    with torch.no_grad():
        once = network(images, sigma)
        thrice = network(3 * images, 3 * sigma)
    assert once.shape == images.shape
    torch.testing.assert_close(thrice, 3 * once)
    assert not torch.allclose(network(images, 2 * sigma), once)  # it listens to the level


# ---- weights files


def test_weights_beyond_half_precision_are_refused(tmp_path):
    with pytest.raises(ValueError, match="float16"):
        halved({"a": torch.tensor([1e6])}, source=tmp_path / "d.safetensors")


def test_files_that_are_not_ours_are_refused(tmp_path):
    path = tmp_path / "d.safetensors"
    path.write_bytes(b"nothing")
    with pytest.raises(ValueError, match="cannot be read as weights"):
        load_denoiser(path)
    save_file({"a": torch.zeros(1)}, path, {"other": "x"})
    with pytest.raises(ValueError, match=f"is no {SCHEMA} file"):
        load_denoiser(path)
    for card in ("{", "[" * 100_000, "9" * 5000):
        save_file({"a": torch.zeros(1)}, path, {SCHEMA: card})
        with pytest.raises(ValueError, match=r"d\.safetensors: its header is not whole"):
            load_denoiser(path)
    save_file({"a": torch.zeros(1)}, path, {SCHEMA: json.dumps({})})
    with pytest.raises(ValueError, match="do not fit"):
        load_denoiser(path)


# ---- the weights in the package


def test_the_card_says_what_they_are():
    assert SHIPPED.stat().st_size <= 1.5 * 2**20
    card = read_card(SHIPPED, SCHEMA)
    text = SHIPPED.with_name("README.md").read_text(encoding="utf-8")
    assert f"{card['steps']:,} updates" in text
    assert f"{round(card['seconds'] / 60)} minutes" in text
    weights = sum(parameter.numel() for parameter in DenoisingNetwork().parameters())
    assert f"{weights:,} weights" in text


def test_tiles_join_without_a_seam(monkeypatch):
    scene = to_linear(data.camera()[100:300, 150:351] / 255)[None]
    sigma = np.array([0.03])
    whole = load_denoiser()(scene, sigma)
    monkeypatch.setattr(denoiser, "_TILE_PX", 70)
    tiled = load_denoiser()(scene, sigma)
    np.testing.assert_allclose(tiled, whole, atol=1e-4)


@pytest.mark.parametrize(
    ("sigma", "least_db"), [(0.003, 0.4), (0.01, 2.0), (0.03, 4.0), (0.1, 7.0)]
)
def test_they_denoise_photos_in_linear_light(sigma, least_db):
    scene = to_linear(data.camera()[100:300, 150:351] / 255)
    noisy = scene + sigma * np.random.default_rng(0).standard_normal(scene.shape)
    denoised = load_denoiser()(noisy[None], np.array([sigma]))[0]
    assert denoised.shape == scene.shape
    assert psnr(denoised, scene) > psnr(noisy, scene) + least_db
