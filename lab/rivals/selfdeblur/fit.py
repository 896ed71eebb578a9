"""Joint fit of both generators to one photo, resumable from its exact state."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from lab.rivals.selfdeblur.config import SelfDeblurConfig
from lab.rivals.selfdeblur.generators import ImageGenerator, KernelGenerator
from motdiff.training.checkpoint import Checkpoint, adam_moments, read_checkpoint, write_checkpoint
from motdiff.training.simulation import blurred

_INPUT_SCALE = 0.1
_SSIM_WINDOW_PX = 11
_SSIM_SIGMA_PX = 1.5
_C1 = 0.01**2
_C2 = 0.03**2


class JointFit:
    """Generators of the sharp photo and of the kernel, fitted together until their blur is the
    photo.

    Parameters
    ----------
    photo : (H, W) float32 tensor, linear light 0..1
        The fit runs on its device.
    config : SelfDeblurConfig

    References
    ----------
    Ren, Zhang, Wang, Hu, Zuo, "Neural blind deconvolution using deep priors", CVPR 2020.
    """

    def __init__(self, photo: Tensor, config: SelfDeblurConfig) -> None:
        self._photo = photo
        self._config = config
        self.iteration = 0
        # light reaches the photo from half a kernel beyond each border: the sharp photo is larger
        # by the kernel less 1
        self._shape = [side + config.kernel_px - 1 for side in photo.shape]
        step = 2**config.levels
        canvas = [max(2 * step, -(-side // step) * step) for side in self._shape]
        self._generator = torch.Generator().manual_seed(config.seed)
        self._noise = _INPUT_SCALE * torch.rand(
            1, config.input_channels, *canvas, generator=self._generator
        )
        self._kernel_noise = _INPUT_SCALE * torch.rand(
            config.kernel_inputs, generator=self._generator
        )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            networks = {"image": ImageGenerator(config), "kernel": KernelGenerator(config)}
        self._kernel_noise = self._kernel_noise.to(photo.device)
        self._networks = nn.ModuleDict(networks).to(photo.device)
        self._rates = {"image": config.image_rate, "kernel": config.kernel_rate}
        self._adam = torch.optim.Adam(
            [
                {"params": self._networks[name].parameters(), "lr": rate}
                for name, rate in self._rates.items()
            ]
        )

    def advance(self) -> float:
        """Update both generators once; returns the loss before."""
        config = self._config
        for group, rate in zip(self._adam.param_groups, self._rates.values(), strict=True):
            group["lr"] = rate * config.decay(self.iteration)
        jitter = torch.randn(self._noise.shape, generator=self._generator)
        image = self._networks["image"](
            (self._noise + config.input_noise * jitter).to(self._photo.device)
        )[0, 0]
        reblurred = blurred(
            image[: self._shape[0], : self._shape[1]], self._networks["kernel"](self._kernel_noise)
        )
        if self.iteration < config.structure_from:
            loss = functional.mse_loss(reblurred, self._photo)
        else:
            loss = 1 - structural_similarity(reblurred, self._photo)
        self._adam.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self._adam.step()
        self.iteration += 1
        return float(loss.detach())

    def kernel(self) -> Tensor:
        """Kernel (k, k) on the CPU: non-negative, sum 1, anywhere in its frame."""
        with torch.no_grad():
            raw_kernel: Tensor = self._networks["kernel"](self._kernel_noise)
        return raw_kernel.cpu()

    def save(self, file: Path | str, *, cpu_s: float = 0.0) -> None:
        """Write the exact state, and the processor time it took, as a checkpoint.

        An older one there stays whole until this one is.
        """
        tensors = {f"model.{name}": tensor for name, tensor in self._networks.state_dict().items()}
        tensors |= adam_moments(self._adam, self._networks)
        tensors["generator"] = self._generator.get_state()
        write_checkpoint(file, Checkpoint(self.iteration, tensors, asdict(self._config), cpu_s))

    def resume(self, file: Path | str) -> float | None:
        """Resume from the state of ``file``; the result is that of an uninterrupted fit.

        Returns
        -------
        Processor time that the state took, seconds; None where there is none.

        Raises
        ------
        ValueError
            If the file holds something else, or the state of generators of other sizes.
        """
        checkpoint = read_checkpoint(file, device=self._photo.device)
        if checkpoint is None:
            return None
        try:
            self._networks.load_state_dict(checkpoint.under("model."))
            checkpoint.restore_adam(self._adam, self._networks)
            self._generator.set_state(checkpoint.tensors["generator"].cpu())
        except (RuntimeError, KeyError) as error:
            raise ValueError(
                f"{file}: its checkpoint belongs to generators of other sizes; remove it"
            ) from error
        self.iteration = checkpoint.step
        return checkpoint.seconds


def structural_similarity(a: Tensor, b: Tensor) -> Tensor:
    """Mean SSIM of two photos (H, W), 0..1, under a Gaussian window of 11 px, where the window is
    whole.

    References
    ----------
    Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment", IEEE TIP 2004.
    """
    at = torch.arange(_SSIM_WINDOW_PX, device=a.device, dtype=a.dtype) - _SSIM_WINDOW_PX // 2
    window = torch.exp(-at.square() / (2 * _SSIM_SIGMA_PX**2))
    window = window / window.sum()
    maps = torch.stack([a, b, a * a, b * b, a * b])[:, None]
    maps = functional.conv2d(
        functional.conv2d(maps, window.view(1, 1, 1, -1)), window.view(1, 1, -1, 1)
    )
    mean_a, mean_b, square_a, square_b, product = maps[:, 0]
    variance = (square_a - mean_a.square()) + (square_b - mean_b.square())
    covariance = product - mean_a * mean_b
    likeness = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    similarity: Tensor = likeness / ((mean_a.square() + mean_b.square() + _C1) * (variance + _C2))
    return similarity.mean()
