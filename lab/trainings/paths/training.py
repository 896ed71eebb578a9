"""Training of the denoiser of motion paths: simulated motions and noise, no photos."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from scipy import fft
from torch import Tensor, nn

from lab.trainings.averaged import AveragedNetwork, set_rate
from motdiff.network.path_denoiser import POINTS, SIGMA_DATA, PathDenoiser
from motdiff.training.motion_bank import MotionMix, drawn_motions
from motdiff.weights import PATH_SCHEMA
from motdiff.weights_io import packed, write_with_card

_TIMES = (np.arange(POINTS) + 0.5) / POINTS
_LEAST_RADIUS_PX = 0.5
_WARM_UP_STEPS = 200
_LONGEST_GRADIENT = 1.0
_AVERAGED = 0.999  # share of the old weights in the running average, once there are enough
_LAST_RATE = 0.01  # of the first, at the end of the cosine
_SIGMA_LOG = (-1.6, 1.6)  # mean and deviation of the noise levels' logarithms
_VALIDATED = (0.02, 0.06, 0.2, 0.6, 2.0)  # noise levels
_HELD_OUT = 4096  # motions, of a tenth of all at most


@dataclass(frozen=True)
class Motions:
    """Motions by their shape and size.

    Attributes
    ----------
    shapes : (N, 63, 2) float32
        Orthonormal cosine coefficients of 64 centred positions over their rms radius.
    radii_px : (N,) float32, px
    """

    shapes: Tensor
    radii_px: Tensor

    def __len__(self) -> int:
        return len(self.radii_px)


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes
    ----------
    minutes : float
        The rate falls to nothing when they are over.
    batch : int
        Motions in an update.
    rate : float
        AdamW's step size.
    seed : int
    """

    minutes: float = 30.0
    batch: int = 1024
    rate: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.minutes <= 0:
            raise ValueError(f"minutes: must be positive, got {self.minutes}")
        if self.batch < 1:
            raise ValueError(f"batch: must be at least 1, got {self.batch}")


def simulated(mix: MotionMix, *, count: int, seed: int) -> Motions:
    """Draw motions of a mix; those that hardly move are left out."""
    motions = drawn_motions(mix, seed=seed, indices=range(count))
    return shaped(np.array([motion.at(_TIMES) for motion in motions], dtype=np.float32))


def shaped(points: np.ndarray) -> Motions:
    """Motions by their points (N, 64, 2), px, at the middles of 64 equal times."""
    coefficients = fft.dct(points, axis=1, norm="ortho")[:, 1:]
    radii_px = np.sqrt((coefficients**2).sum(axis=(1, 2)) / POINTS)
    moving = radii_px > _LEAST_RADIUS_PX
    shapes = coefficients[moving] / radii_px[moving, None, None]
    return Motions(*(torch.from_numpy(values).float() for values in (shapes, radii_px[moving])))


def turned(shapes: Tensor, generator: torch.Generator) -> Tensor:
    """Turn shapes (B, 63, 2) by any angle, mirror half of them, and run half of them backwards."""

    def uniform() -> Tensor:
        return torch.rand(len(shapes), generator=generator)

    angle, mirror, time_sign = 2 * math.pi * uniform(), _signs(uniform()), _signs(uniform())
    turn = torch.stack(
        [angle.cos(), -angle.sin(), mirror * angle.sin(), mirror * angle.cos()], dim=-1
    ).view(-1, 2, 2)
    # a path run backwards: cosines of odd order change sign
    odd = (torch.arange(1, POINTS) % 2).bool()
    backwards = torch.where(odd[None, :, None], time_sign[:, None, None], 1.0)
    return (shapes @ turn) * backwards


def _signs(uniform: Tensor) -> Tensor:
    return torch.where(uniform < 0.5, 1.0, -1.0)


class PathTrainer(AveragedNetwork[PathDenoiser]):
    """Network, its optimiser, and the running average of its weights.

    Parameters
    ----------
    motions : Motions
        To train on.
    settings : Settings
    """

    def __init__(self, motions: Motions, settings: Settings) -> None:
        super().__init__(PathDenoiser, seed=settings.seed, device="cpu", old_share=_AVERAGED)
        variances = motions.shapes.square().mean(dim=(0, 2))
        for network in (self.network, self.average):
            network.variances.copy_(variances)
        self._motions = motions
        self._settings = settings
        self._adam = torch.optim.AdamW(
            self.network.parameters(), lr=settings.rate, betas=(0.9, 0.99), weight_decay=0.01
        )
        self._generator = torch.Generator().manual_seed(settings.seed)

    def update(self, *, share: float) -> float:
        """Make one update, when a ``share`` of the time has passed; returns the loss."""
        rate = self._settings.rate * min(1.0, (self.step + 1) / _WARM_UP_STEPS)
        set_rate(self._adam, rate * max(_LAST_RATE, 0.5 * (1 + math.cos(math.pi * share))))
        count = self._settings.batch
        chosen = torch.randint(len(self._motions), (count,), generator=self._generator)
        mean, deviation = _SIGMA_LOG
        sigma = torch.exp(mean + deviation * torch.randn(count, generator=self._generator))
        shapes = turned(self._motions.shapes[chosen], self._generator)
        radii_px = self._motions.radii_px[chosen]
        loss = denoising_loss(self.network, shapes, radii_px, sigma, self._generator)
        self._adam.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._adam.step()
        self.advance()
        return float(loss.detach())


def denoising_loss(
    network: PathDenoiser,
    shapes: Tensor,
    radii_px: Tensor,
    sigma: Tensor,
    generator: torch.Generator,
) -> Tensor:
    """Mean squared error of denoised shapes (B, 63, 2), 1 for a network that gives 0 (EDM, eq. 8).

    Parameters
    ----------
    radii_px : (B,), px
    sigma : (B,)
        Noise levels.
    """
    noise = torch.randn(shapes.shape, generator=generator)
    denoised = network(shapes + sigma[:, None, None] * noise, sigma, radii_px)
    weight = (sigma.square() + SIGMA_DATA**2) / (sigma * SIGMA_DATA).square()
    loss: Tensor = (weight * (denoised - shapes).square().mean(dim=(1, 2))).mean()
    return loss


def train(
    motions: Motions,
    target: Path | str,
    *,
    settings: Settings = Settings(),
    validate_s: float = 60.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> None:
    """Train until the time is over; the last motions, a tenth at most, validate.

    Parameters
    ----------
    motions : Motions
    target : path
        Weights file, written whole at each validation.
    settings : Settings
    validate_s : float
        Seconds between validations.
    clock : callable
        Seconds.
    report : callable
        Called with a line at every validation.

    Raises
    ------
    ValueError
        If there are fewer than ten motions.
    """
    if len(motions) < 10:
        raise ValueError(f"motions: need at least 10 that move, got {len(motions)}")
    held_out = min(_HELD_OUT, len(motions) // 10)
    train_count = len(motions) - held_out
    trainer = PathTrainer(
        Motions(motions.shapes[:train_count], motions.radii_px[:train_count]), settings
    )
    validation = Motions(motions.shapes[train_count:], motions.radii_px[train_count:])
    started = validated = clock()
    share = 0.0
    while share < 1:
        loss = trainer.update(share=share)
        moment = clock()
        share = (moment - started) / (60 * settings.minutes)
        if moment - validated < validate_s and share < 1:
            continue
        losses = validation_losses(trainer.average, validation, seed=settings.seed)
        card = {"settings": asdict(settings), "step": trainer.step, "losses": losses}
        tensors = packed(trainer.average.state_dict(), source=target)
        write_with_card(tensors, target, schema=PATH_SCHEMA, card=card)
        values = ", ".join(f"{value:.4f} at {sigma}" for sigma, value in losses.items())
        report(f"{trainer.step} updates, {moment - started:.0f} s, loss {loss:.3f}; {values}")
        validated = clock()


@torch.no_grad()
def validation_losses(network: PathDenoiser, motions: Motions, *, seed: int) -> dict[str, float]:
    """Losses by noise level; the same noise at every call."""
    generator = torch.Generator().manual_seed(seed)
    return {
        f"{sigma:g}": float(
            denoising_loss(
                network,
                motions.shapes,
                motions.radii_px,
                torch.full((len(motions),), sigma),
                generator,
            )
        )
        for sigma in _VALIDATED
    }
