"""BlindDPS with weights of the user: photo and kernel sampled jointly from two diffusion priors.

Nothing here ships a diffusion prior of photos. A folder of weights holds two files of
:func:`write_prior`:

- ``image.safetensors``, of (1, C, S, S), C = 1 or 3: photos as ``2 v - 1`` of their display values
  v (sRGB), such as FFHQ's;
- ``kernel.safetensors``, of (1, 1, K, K), K < S: kernels as ``2 k / max(k) - 1``.

Each is a network ``eps(x, t)`` that predicts the noise in ``x`` (float32) at timestep ``t`` ((1,)
int64, 0..999) of the linear schedule of :func:`linear_alpha_bar`; further output channels, such as
a learned variance, are ignored. The authors' checkpoints are turned into such files once
(:func:`write_prior` has the example). Programs and pickles are not read: both run code of whoever
wrote them. A network of another kind goes into ``BlindDpsEstimator`` as a :class:`Prior`, in a
module of one's own that ``module:name`` names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from lab.rivals.adm_unet import AdmConfig, AdmUNet
from motdiff.crops import pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.description import estimate_from_kernel
from motdiff.files.inputs import one_line
from motdiff.photo_values import luminance
from motdiff.training.simulation import blurred
from motdiff.weights_io import filled, halved, read_card, write_with_card

_SCHEMA = "motdiff.prior/1"
_IMAGE = "image.safetensors"
_KERNEL = "kernel.safetensors"
_SRGB_KNEE = 0.0031308 * 12.92


@dataclass(frozen=True)
class Prior:
    """Diffusion prior of one unknown.

    Attributes
    ----------
    eps : callable
        Noise in a noisy signal (1, C, S, S) at timestep (1,) int64; further channels of its output
        are ignored.
    shape : tuple of int
        (1, C, S, S).
    device : torch.device
    """

    eps: Callable[[Tensor, Tensor], Tensor]
    shape: tuple[int, ...]
    device: torch.device


class BlindDpsEstimator:
    """Blind estimator that samples photo and kernel from their approximate posterior under two
    diffusion priors.

    Parameters
    ----------
    priors : pair of Prior, optional
        Of the photo and of the kernel, see :func:`load_priors`; without them :meth:`estimate`
        raises an error.
    strength : float
        Of the pull towards the blurred photo, times the square root of ``alpha_bar``.
    seed : int
        Of the draw.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises
    ------
    ValueError
        If the priors' shapes or devices do not belong together.

    References
    ----------
    Chung, Kim, Kim, Ye, "Parallel diffusion models of operator and image for blind inverse
    problems", CVPR 2023.
    """

    def __init__(
        self,
        priors: tuple[Prior, Prior] | None = None,
        *,
        strength: float = 1.0,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        if not (math.isfinite(strength) and strength >= 0):
            raise ValueError(f"strength: must be a number of at least 0, got {strength}")
        self._strength = strength
        self._seed = seed
        self._progress = progress
        if priors is not None:
            _check_pair(*priors)
        self._priors = priors

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Draw the kernel of ``photo``, (H, W) or (H, W, 3), linear light 0..1, in its best crop
        of S - K + 1 px.

        Its centroid lies at index 32, to whole pixels. The draw is not scored: ``confidence`` is
        0.

        Raises
        ------
        ValueError
            If there are no weights, or the photo is smaller than the crop, not finite, or without
            texture.
        """
        if self._priors is None:
            raise ValueError(
                f"needs weights: a folder with {_IMAGE} and {_KERNEL}, see lab.rivals.blinddps"
            )
        image, kernel = self._priors
        channels = image.shape[1]
        size = image.shape[-1] - kernel.shape[-1] + 1
        window = torch.from_numpy(_window(photo, size, channels).astype(np.float32)).to(
            image.device
        )

        def residual(image_signal: Tensor, kernel_signal: Tensor) -> Tensor:
            return 2 * (
                window - blurred(_to_linear((image_signal[0] + 1) / 2), _kernel_of(kernel_signal))
            )

        samples = sample_jointly(
            (image, kernel),
            residual,
            alpha_bar=linear_alpha_bar(),
            strength=self._strength,
            generator=torch.Generator().manual_seed(self._seed),
            progress=self._progress,
        )
        details = {"misfit": float(residual(*samples).square().mean().sqrt()) / 2, "crop_px": size}
        return estimate_from_kernel(
            "blinddps", _kernel_of(samples[1]).double().cpu().numpy(), details
        )


def load_priors(folder: Path | str, *, device: torch.device | str = "cpu") -> tuple[Prior, Prior]:
    """Load the priors of the photo and of the kernel from ``image.safetensors`` and
    ``kernel.safetensors``.

    Raises
    ------
    FileNotFoundError
        If a file is missing in the folder.
    ValueError
        If a file is not one of :func:`write_prior`, or the two do not belong together.
    """
    image, kernel = (
        _load_prior(Path(folder) / name, torch.device(device)) for name in (_IMAGE, _KERNEL)
    )
    try:
        _check_pair(image, kernel)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from None
    return image, kernel


def write_prior(state: Mapping[str, Tensor], target: Path | str, config: AdmConfig) -> int:
    """Write the weights of a prior with the size of its network in the header; returns the bytes.

    Parameters
    ----------
    state : mapping of tensors
        Of an :class:`lab.rivals.adm_unet.AdmUNet`, whose names are those of guided-diffusion.
    target : .safetensors file to write
    config : AdmConfig

    Raises
    ------
    ValueError
        If the tensors do not fit the network, or float16 cannot hold them.

    Examples
    --------
    The authors' checkpoints become a folder of weights once and for all::

        for source, name, config in (
            ("ffhq_10m.pt", "image", AdmConfig(256, 3, 128, (1, 1, 2, 2, 4, 4))),
            ("kernel_checkpoint.pt", "kernel", AdmConfig(64, 1, 64, (1, 2, 3, 4))),
        ):
            write_prior(torch.load(source, weights_only=True), f"priors/{name}.safetensors",
            config)
    """
    with torch.device("meta"):
        network = AdmUNet(config)
    try:
        network.load_state_dict(dict(state), assign=True)
    except RuntimeError as error:
        raise ValueError(f"{target}: these tensors do not fit a network of {config}") from error
    tensors = halved(state, source=target)
    return write_with_card(tensors, target, schema=_SCHEMA, card=asdict(config))


def linear_alpha_bar() -> tuple[float, ...]:
    """Share of the signal's power left at timestep 0..999, with noise of variance 1e-4 to 0.02
    added at each.

    References
    ----------
    Ho, Jain, Abbeel, "Denoising diffusion probabilistic models", NeurIPS 2020, section 4.
    """
    beta = torch.linspace(1e-4, 0.02, 1000, dtype=torch.float64)
    return tuple(torch.cumprod(1 - beta, dim=0).tolist())


def sample_jointly(
    priors: tuple[Prior, Prior],
    residual: Callable[[Tensor, Tensor], Tensor],
    *,
    alpha_bar: Sequence[float],
    strength: float,
    generator: torch.Generator,
    progress: Callable[[float], None] | None = None,
) -> tuple[Tensor, Tensor]:
    r"""Sample two signals jointly, each by its own diffusion, both guided by the measurement.

    At each timestep, from both noisy signals at once, with ``x0`` the clean signals that their
    priors guess ::

        x_{t-1} = posterior mean of x_t and x0 + noise - strength sqrt(alpha_bar_t) grad_{x_t}
        |residual(x0)|

    The paper's step is constant; this one, which grows as the guesses get better, is that of its
    authors' program. Their penalty on the kernel's sum is left out: it is constant for kernels of
    sum 1.

    Parameters
    ----------
    priors : pair of Prior
    residual : callable
        Residual of the measurement, any shape, for two clean signals.
    alpha_bar : sequence of float
        Share of the signal's power left at timestep 0..T-1.
    strength : float
        0 draws from the priors alone.
    generator : torch.Generator
        On the CPU; noise is drawn there.
    progress : callable, optional
        Called with the finished share 0..1.

    Returns
    -------
    pair of tensors of the priors' shapes, within -1..1
    """

    def noise(prior: Prior) -> Tensor:
        return torch.randn(prior.shape, generator=generator).to(prior.device)

    noisy = [noise(prior) for prior in priors]
    for t in reversed(range(len(alpha_bar))):
        alpha_bar_t = alpha_bar[t]
        before = alpha_bar[t - 1] if t else 1.0
        with torch.enable_grad():
            noisy = [signal.requires_grad_() for signal in noisy]
            clean = [
                _guess(prior, signal, t, alpha_bar_t)
                for prior, signal in zip(priors, noisy, strict=True)
            ]
            distance = torch.linalg.vector_norm(residual(clean[0], clean[1]))
            pulls = torch.autograd.grad(distance, noisy)
        weight_x_t = math.sqrt(alpha_bar_t / before) * (1 - before) / (1 - alpha_bar_t)
        weight_x_0 = math.sqrt(before) * (1 - alpha_bar_t / before) / (1 - alpha_bar_t)
        spread = math.sqrt((1 - before) / (1 - alpha_bar_t) * (1 - alpha_bar_t / before))
        noisy = [
            weight_x_t * signal.detach()
            + weight_x_0 * guess.detach()
            + spread * noise(prior)
            - strength * math.sqrt(alpha_bar_t) * pull
            for prior, signal, guess, pull in zip(priors, noisy, clean, pulls, strict=True)
        ]
        if progress is not None:
            progress(1 - t / len(alpha_bar))
    return noisy[0].clamp(-1, 1), noisy[1].clamp(-1, 1)


def _guess(prior: Prior, noisy: Tensor, t: int, alpha_bar: float) -> Tensor:
    """Clean signal, by Tweedie's formula."""
    eps = prior.eps(noisy, torch.full((1,), t, dtype=torch.int64, device=prior.device))[
        :, : prior.shape[1]
    ]
    return ((noisy - math.sqrt(1 - alpha_bar) * eps) / math.sqrt(alpha_bar)).clamp(-1, 1)


def _check_pair(image: Prior, kernel: Prior) -> None:
    for name, prior in (("image", image), ("kernel", kernel)):
        shape = prior.shape
        if len(shape) != 4 or shape[0] != 1 or shape[2] != shape[3]:
            raise ValueError(
                f"{name} prior: must be eps(x, t) of x in a fixed shape (1, C, S, S), got {shape}"
            )
    if image.shape[1] not in (1, 3) or kernel.shape[1] != 1 or kernel.shape[-1] >= image.shape[-1]:
        raise ValueError(
            "priors: need an image prior of 1 or 3 channels and a smaller kernel prior of 1, "
            f"got {image.shape} and {kernel.shape}"
        )
    if image.device != kernel.device:
        raise ValueError(
            f"priors: must both be on one device, got {image.device} and {kernel.device}"
        )


def _load_prior(file: Path, device: torch.device) -> Prior:
    if not file.is_file():
        raise FileNotFoundError(
            f"{file}: no such file; BlindDPS needs {_IMAGE} and {_KERNEL} in this folder"
        )
    card = read_card(file, _SCHEMA)
    try:
        config = AdmConfig(**card)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}: its header describes no network ({one_line(error)})") from None
    with torch.device("meta"):  # the header may ask for more memory than the file's tensors have
        network = AdmUNet(config)
    return Prior(
        filled(network, file, schema=_SCHEMA).to(device),
        (1, config.channels, config.size, config.size),
        device,
    )


def _window(photo: ArrayLike, size: int, channels: int) -> NDArray[np.float64]:
    """Best crop (C, size, size) of a photo."""
    grey = luminance(photo)
    if min(grey.shape) < size:
        raise ValueError(
            f"photo: these weights need at least {size} x {size} px, got {grey.shape[1]} x"
            f" {grey.shape[0]}"
        )
    if np.ptp(grey) == 0:
        raise ValueError("photo: is constant; motion shows only where the scene has texture")
    ((row, column),) = pick_crops(grey, size=size, count=1)
    image = np.asarray(photo, dtype=np.float64)
    light = (
        image
        if channels == 3 and image.ndim == 3 and image.shape[2] == 3
        else np.stack([grey] * channels, axis=2)
    )
    return np.moveaxis(light[row : row + size, column : column + size], 2, 0)


def _kernel_of(signal: Tensor) -> Tensor:
    light = (signal[0, 0] + 1) / 2
    return light / light.sum().clamp(min=1e-6)


def _to_linear(display: Tensor) -> Tensor:
    """Decode sRGB values 0..1; blur happens in linear light, while photos for priors are encoded
    for display.
    """
    high = ((display.clamp(min=_SRGB_KNEE) + 0.055) / 1.055) ** 2.4
    return torch.where(display <= _SRGB_KNEE, display / 12.92, high)
