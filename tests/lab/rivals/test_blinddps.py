"""BlindDPS with Gaussian priors, whose scores are known exactly, and the folder of weights that it
runs from."""

import json
import pickle
import zipfile

import numpy as np
import pytest
import torch
from dead_leaves import dead_leaves
from safetensors.torch import save_file

from lab.evaluation.measure import measure_estimator
from lab.evaluation.methods import named_estimators
from lab.evaluation.sets import Case
from lab.rivals.adm_unet import AdmConfig, AdmUNet
from lab.rivals.blinddps import (
    BlindDpsEstimator,
    Prior,
    linear_alpha_bar,
    load_priors,
    sample_jointly,
    write_prior,
)
from motdiff.metrics import mnc_subpixel
from motdiff.photo_values import to_display
from motdiff.simulate import blur_valid

CPU = torch.device("cpu")
ALPHA_BAR = np.cumprod(1 - np.linspace(1e-4, 0.02, 1000))
PSF = np.zeros((9, 9))
PSF[[1, 2, 3, 4, 5, 6], [2, 3, 4, 5, 5, 6]] = [0.25, 0.2, 0.2, 0.15, 0.1, 0.1]


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class GaussianEps(torch.nn.Module):
    """The noise expected in a noisy signal whose clean one is N(mean, variance) in each pixel."""

    def __init__(self, mean, variance, alpha_bar=ALPHA_BAR, *, more_channels=0):
        super().__init__()
        for name, value in (("mean", mean), ("variance", variance), ("alpha_bar", alpha_bar)):
            self.register_buffer(
                name, torch.tensor(np.ascontiguousarray(value), dtype=torch.float32)
            )
        self.more_channels = more_channels

    def forward(self, x, t):
        a = self.alpha_bar[t].view(-1, 1, 1, 1)
        eps = torch.sqrt(1 - a) * (x - torch.sqrt(a) * self.mean) / (a * self.variance + 1 - a)
        return torch.cat([eps] + [x] * self.more_channels, dim=1)


def prior(mean, variance, shape, alpha_bar=ALPHA_BAR):
    return Prior(GaussianEps(mean, variance, alpha_bar), shape, CPU)


def drawn(priors, residual, *, strength, seed=0, alpha_bar=ALPHA_BAR):
    generator = torch.Generator().manual_seed(seed)
    return sample_jointly(
        priors, residual, alpha_bar=alpha_bar, strength=strength, generator=generator
    )


def test_the_schedule_is_the_usual_one():
    np.testing.assert_allclose(linear_alpha_bar(), ALPHA_BAR, rtol=1e-12)
    assert ALPHA_BAR[-1] == pytest.approx(4.04e-5, rel=0.01)


def test_without_a_pull_the_priors_are_sampled():
    """Mean and variance of 4096 pixels, within four standard errors; the two signals are
    independent."""
    shape = (1, 1, 64, 64)
    x, k = drawn(
        (prior(0.1, 0.04, shape), prior(-0.2, 0.01, shape)),
        lambda x0, k0: (x0 * k0).flatten() + 1,
        strength=0.0,
    )
    for signal, mean, variance in ((x, 0.1, 0.04), (k, -0.2, 0.01)):
        assert signal.mean().item() == pytest.approx(mean, abs=4 * (variance / 4096) ** 0.5)
        assert signal.var().item() == pytest.approx(variance, rel=4 * (2 / 4096) ** 0.5 + 0.01)
    assert abs(np.corrcoef(x.flatten(), k.flatten())[0, 1]) < 4 / 64


def test_every_step_is_the_closed_form():
    """A chain of four steps replayed in numpy with the gradient worked out by hand, where y = x0 +
    3 k0."""
    alpha_bar = np.array([0.95, 0.8, 0.5, 0.2])
    strength = 0.05
    shape = (1, 1, 2, 3)
    measured = np.linspace(-0.3, 0.5, 6).reshape(shape)
    told = torch.from_numpy(measured)
    means = (0.1, -0.05)
    variances = (0.02, 0.005)
    priors = tuple(prior(m, v, shape, alpha_bar) for m, v in zip(means, variances, strict=True))
    found = drawn(
        priors, lambda x0, k0: told - x0 - 3 * k0, strength=strength, alpha_bar=alpha_bar
    )

    generator = torch.Generator().manual_seed(0)
    signals = [
        torch.randn(shape, generator=generator).numpy().astype(np.float64) for _ in range(2)
    ]
    for t in (3, 2, 1, 0):
        a = alpha_bar[t]
        a_before = alpha_bar[t - 1] if t else 1.0
        gains = [
            np.sqrt(a) * v / (a * v + 1 - a) for v in variances
        ]  # of the posterior mean, per unit of the signal
        clean = [
            m + gain * (s - np.sqrt(a) * m)
            for m, gain, s in zip(means, gains, signals, strict=True)
        ]
        left = measured - clean[0] - 3 * clean[1]
        pulls = [
            -weight * gain * left / np.linalg.norm(left)
            for weight, gain in zip((1, 3), gains, strict=True)
        ]
        beta = 1 - a / a_before
        stays = np.sqrt(1 - beta) * (1 - a_before) / (1 - a)
        comes = np.sqrt(a_before) * beta / (1 - a)
        spread = np.sqrt(beta * (1 - a_before) / (1 - a))
        noises = [torch.randn(shape, generator=generator).numpy() for _ in range(2)]
        signals = [
            stays * s + comes * c + spread * n - strength * np.sqrt(a) * p
            for s, c, n, p in zip(signals, clean, noises, pulls, strict=True)
        ]
    for mine, expected in zip(found, signals, strict=True):
        np.testing.assert_allclose(mine.numpy(), expected, atol=2e-6)


# ---- from a pair of priors


def gaussian_priors(sharp, *, more_channels=0):
    """Priors of one photo's neighbourhood and of kernels that are bright in the middle, and that
    middle."""
    channels = 1 if sharp.ndim == 2 else sharp.shape[2]
    image = 2 * np.moveaxis(to_display(sharp).reshape(*sharp.shape[:2], channels), 2, 0)[None] - 1
    y, x = np.mgrid[:9, :9] - 4
    middle = np.exp(-(x**2 + y**2) / 8)
    photos = Prior(GaussianEps(image, 1e-4, more_channels=more_channels), image.shape, CPU)
    return (photos, prior(0.6 * middle - 1, 0.3 * middle + 1e-3, (1, 1, 9, 9))), middle


SHARP = dead_leaves(40, 1)
PHOTO = blur_valid(SHARP, PSF)


@pytest.mark.slow(reason="two thousand steps of diffusion")
def test_finds_the_kernel_that_the_prior_does_not_know():
    priors, middle = gaussian_priors(SHARP)
    seen = []
    estimate = BlindDpsEstimator(priors, strength=0.3, progress=seen.append).estimate(PHOTO)
    assert mnc_subpixel(estimate.psf, PSF) > max(0.9, mnc_subpixel(middle, PSF) + 0.3)
    assert mnc_subpixel(estimate.psf, PSF) > mnc_subpixel(estimate.psf, PSF[::-1, ::-1]) + 0.02
    assert (estimate.method, estimate.confidence, estimate.psf.shape) == (
        "blinddps",
        0.0,
        (64, 64),
    )
    assert estimate.details["crop_px"] == 32
    assert estimate.details["misfit"] < 0.03
    assert len(seen) == 1000
    assert seen == sorted(seen)
    assert seen[-1] == 1
    untold = BlindDpsEstimator(priors, strength=0.0).estimate(PHOTO)
    assert untold.details["misfit"] > 2 * estimate.details["misfit"]


def test_colour_priors_and_learned_variances_are_taken(monkeypatch):
    monkeypatch.setattr("lab.rivals.blinddps.linear_alpha_bar", lambda: tuple(ALPHA_BAR[:50]))
    colour = np.stack([SHARP, 0.5 * SHARP, SHARP**2], axis=2)
    photo = blur_valid(colour, PSF)
    priors = [gaussian_priors(colour, more_channels=count)[0] for count in (0, 1)]
    plain, learned = (BlindDpsEstimator(pair).estimate(photo) for pair in priors)
    np.testing.assert_array_equal(plain.psf, learned.psf)
    grey = BlindDpsEstimator(priors[0]).estimate(photo.mean(axis=2))
    assert grey.details["misfit"] > plain.details["misfit"]
    assert (
        BlindDpsEstimator(gaussian_priors(SHARP)[0]).estimate(photo).details["crop_px"] == 32
    )  # its luminance


def test_without_weights_its_row_says_so():
    (method,) = named_estimators(["blinddps"]).values()
    with pytest.raises(
        ValueError,
        match=r"^needs weights: a folder with image\.safetensors and kernel\.safetensors",
    ):
        measure_estimator(Case(PHOTO, PSF), method, restore=False)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (
            ((1, 1, 20, 24), (1, 1, 9, 9)),
            r"image prior: must be eps\(x, t\) of x in a fixed shape \(1, C, S, S\)",
        ),
        (
            ((1, 1, 9, 9), (1, 1, 9, 9)),
            "priors: need an image prior of 1 or 3 channels and a smaller kernel prior of 1",
        ),
    ],
)
def test_priors_that_do_not_belong_together_are_refused(shapes, words):
    with pytest.raises(ValueError, match=f"^{words}"):
        BlindDpsEstimator(tuple(prior(0, 1, shape) for shape in shapes))
    with pytest.raises(ValueError, match="strength: must be a number of at least 0, got nan"):
        BlindDpsEstimator(strength=float("nan"))


@pytest.mark.parametrize(
    ("photo", "words"),
    [
        (
            np.full((100, 100), 0.4),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (
            np.random.default_rng(0).random((31, 300)),
            "photo: these weights need at least 32 x 32 px, got 300 x 31",
        ),
        (np.full((100, 100), np.nan), "photo: must be finite, found NaN or infinity"),
    ],
)
def test_unusable_photos_are_refused_in_one_line(photo, words):
    with pytest.raises(ValueError, match=f"^{words}$"):
        BlindDpsEstimator(gaussian_priors(SHARP)[0]).estimate(photo)


# ---- from a folder of weights

IMAGE = AdmConfig(size=32, channels=3, width=32, multipliers=(1, 2), attention=(16,))
KERNEL = AdmConfig(
    size=8, channels=1, width=32, multipliers=(2,), attention=(), learned_variance=False
)


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "weights"
    folder.mkdir()
    torch.manual_seed(0)
    for name, config in (("image", IMAGE), ("kernel", KERNEL)):
        write_prior(AdmUNet(config).state_dict(), folder / f"{name}.safetensors", config)
    return folder


def test_the_name_takes_a_folder(folder, monkeypatch):
    monkeypatch.setattr("lab.rivals.blinddps.linear_alpha_bar", lambda: tuple(ALPHA_BAR[:3]))
    name = f"blinddps:{folder}"
    estimate = named_estimators([name])[name].estimate(PHOTO)
    assert estimate.details["crop_px"] == 32 - 8 + 1
    with pytest.raises(
        FileNotFoundError, match=r"nowhere/image.safetensors: no such file; BlindDPS needs"
    ):
        named_estimators(["blinddps:nowhere"])


def test_weights_come_back_as_they_were_written(folder):
    torch.manual_seed(0)
    network = AdmUNet(IMAGE).eval()
    loaded, _ = load_priors(folder)
    x = torch.randn(loaded.shape)
    t = torch.tensor([321])
    with torch.no_grad():
        torch.testing.assert_close(
            loaded.eps(x, t), network(x, t), atol=5e-3, rtol=5e-3
        )  # float16
    assert loaded.shape == (1, 3, 32, 32)
    assert loaded.eps(x, t).shape == (1, 6, 32, 32)


def test_unusable_weights_are_refused(folder):
    image = folder / "image.safetensors"
    state = AdmUNet(IMAGE).state_dict()

    def refused(words):
        with pytest.raises(ValueError, match=words) as caught:
            load_priors(folder)
        assert "\n" not in str(caught.value)

    image.write_bytes(b"no weights")
    refused("image.safetensors: cannot be read as weights")
    image.write_bytes((folder / "kernel.safetensors").read_bytes())
    refused(
        "weights: priors: need an image prior of 1 or 3 channels and a smaller kernel prior of 1"
    )
    card = {"size": 32, "channels": 3, "width": 32, "multipliers": [1, 2]}
    for wrong, words in (
        ({**card, "blocks": 3}, "its tensors do not fit the network"),
        (
            {**card, "blocks": 10**9},
            r"its header describes no network \(blocks: must be a whole number within 1..8",
        ),
        ({**card, "width": 4096, "multipliers": [1, 1]}, "its tensors do not fit the network"),
        ({**card, "width": "32"}, "its header describes no network"),
        ({**card, "multipliers": [1] * 9}, "its header describes no network"),
        ({**card, "program": "os.system"}, "its header describes no network"),
        ([1], "its header describes no network"),
    ):
        save_file(state, image, {"motdiff.prior/1": json.dumps(wrong)})
        refused(f"image.safetensors: {words}")


class Trap:
    """A pickle of this writes a file when it is loaded."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (open, (str(self.mark), "w"))


@pytest.mark.parametrize("name", ["image.pt2", "image.pt", "image.safetensors"])
def test_no_file_of_weights_is_unpickled(tmp_path, folder, name):
    """A program of torch.export, a checkpoint of torch.save and a bare pickle, each under each
    name."""
    mark = tmp_path / "mark"
    network = torch.nn.ReLU()
    program = torch.export.export(network, (torch.zeros(1, 1, 4, 4),))
    torch.export.save(program, tmp_path / "program.pt2")
    torch.save(Trap(mark), tmp_path / "checkpoint.pt")
    with (
        zipfile.ZipFile(tmp_path / "program.pt2") as whole,
        zipfile.ZipFile(tmp_path / "bad.pt2", "w") as bad,
    ):
        for member in whole.namelist():
            harmful = "sample_inputs" in member
            bad.writestr(
                member,
                (tmp_path / "checkpoint.pt").read_bytes() if harmful else whole.read(member),
            )
    (tmp_path / "bare").write_bytes(pickle.dumps(Trap(mark)))
    if name != "image.safetensors":
        (folder / "image.safetensors").unlink()
    for harmful in ("bad.pt2", "checkpoint.pt", "bare"):
        (folder / name).write_bytes((tmp_path / harmful).read_bytes())
        with pytest.raises((ValueError, FileNotFoundError), match=r"image\.safetensors"):
            named_estimators([f"blinddps:{folder}"])
    assert not mark.exists()
