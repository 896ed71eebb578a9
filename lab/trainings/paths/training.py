"""Training of the denoiser of paths."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from lab.trainings.averaged import AveragedNetwork, set_rate
from lab.trainings.paths.batches import Batches
from lab.trainings.paths.evaluation import figures
from lab.trainings.paths.network import SIGMA_DATA, UNIT_PX, PathDenoiser, rendered
from lab.trainings.paths.samples import PathSamples
from motdiff.weights_io import packed, write_with_card

SCHEMA = "lab.paths/1"
_WARM_UP_STEPS = 300
_LONGEST_GRADIENT = 1.0
_EXPLODED = 30.0  # gradients so long are thrown away: they ruined a run
_AVERAGED = 0.9995  # share of the old weights in the running average, once there are enough
_LAST_RATE = 0.02  # of the first, at the end of the cosine
_SIGMA_LOG = (-1.3, 1.5)  # mean and deviation of the noise levels' logarithms
_LARGEST_WEIGHT = 400.0  # of an error, at the smallest noise levels
_SHAPED_BELOW = 0.6  # noise levels at which the denoised path has the shape of one


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes
    ----------
    minutes : float
        The rate falls to nothing when they are over.
    batch : int
        Photos in an update, each with ``repeats`` noise levels.
    repeats : int
    rate : float
        AdamW's step size.
    clean : float
        Share of photos that are motions without a search, whose kernels have faults drawn on.
    shape : float
        Weight of the PSFs' correlation beside the error of the points.
    channels, layers, width : int
        Of :class:`~lab.trainings.paths.network.PathDenoiser`.
    seed : int
    """

    minutes: float = 7.0
    batch: int = 256
    repeats: int = 4
    rate: float = 3e-4
    clean: float = 0.4
    shape: float = 0.3
    channels: int = 160
    layers: int = 6
    width: int = 32
    seed: int = 0

    def __post_init__(self) -> None:
        if self.minutes <= 0:
            raise ValueError(f"minutes: must be positive, got {self.minutes}")
        if self.batch < 1:
            raise ValueError(f"batch: must be at least 1, got {self.batch}")

    def network(self) -> PathDenoiser:
        """Build a network of these sizes."""
        return PathDenoiser(self.channels, self.layers, self.width)


class DrawnPathTrainer(AveragedNetwork[PathDenoiser]):
    """Network, its optimiser, and the running average of its weights.

    Parameters
    ----------
    settings : Settings
    device : str
    """

    def __init__(self, settings: Settings, *, device: str = "cpu") -> None:
        super().__init__(settings.network, seed=settings.seed, device=device, old_share=_AVERAGED)
        self.settings = settings
        self._adam = torch.optim.AdamW(
            self.network.parameters(), lr=settings.rate, betas=(0.9, 0.98), weight_decay=0.02
        )
        self.generator = torch.Generator(device).manual_seed(settings.seed)
        self.thrown_away = 0

    def update(self, maps: Tensor, points: Tensor, *, share: float) -> float:
        """Make one update, when a ``share`` of the time has passed; returns the loss.

        Parameters
        ----------
        maps : (B, 4, 64, 64) float
        points : (B, 64, 2) float, px
        """
        rate = self.settings.rate * min(1.0, (self.step + 1) / _WARM_UP_STEPS)
        set_rate(self._adam, rate * max(_LAST_RATE, 0.5 * (1 + math.cos(math.pi * share))))
        loss = self._loss(maps, points.repeat_interleave(self.settings.repeats, dim=0))
        self._adam.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        length = float(nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT))
        if math.isfinite(length) and length <= _EXPLODED:
            self._adam.step()
        else:
            self.thrown_away += 1
        self.advance()
        return float(loss.detach())

    def _loss(self, maps: Tensor, points: Tensor) -> Tensor:
        x0 = points / UNIT_PX
        mean, deviation = _SIGMA_LOG
        noise = torch.randn(x0.shape, generator=self.generator, device=x0.device)
        levels = torch.randn(len(x0), generator=self.generator, device=x0.device)
        sigma = torch.exp(mean + deviation * levels)
        with self.single_or_bf16():
            condition = self.network.condition(maps)
            denoised = self.network(x0 + sigma[:, None, None] * noise, sigma, condition).float()
        weight = (sigma.square() + SIGMA_DATA**2) / (sigma * SIGMA_DATA).square()
        error = (denoised - x0).square().mean(dim=(1, 2))
        loss = (weight.clamp(max=_LARGEST_WEIGHT) * error).mean()
        shaped = (sigma < _SHAPED_BELOW).float()
        psfs, truth = rendered(UNIT_PX * denoised), rendered(points)
        # the sharp ones are nearly MNC; the blurred ones pull from farther away
        unlike = 1 - _correlation(psfs, truth) + 1 - _correlation(_blurred(psfs), _blurred(truth))
        shape = (shaped * unlike).sum() / (2 * shaped.sum().clamp(min=1))
        total: Tensor = loss + self.settings.shape * shape
        return total


def train(
    samples: PathSamples,
    held_out: PathSamples,
    motions: Tensor,
    target: Path | str,
    *,
    settings: Settings = Settings(),
    device: str = "cpu",
    validate_s: float = 40.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> None:
    """Train until the time is over; the file holds the weights that validated best.

    Parameters
    ----------
    samples, held_out : PathSamples
    motions : (M, 64, 2) float, px
        Of :func:`~lab.trainings.paths.samples.clean_points`.
    target : path
        Weights file, written whole at each validation that is better than those before.
    settings : Settings
    device : str
    validate_s : float
        Seconds between validations.
    clock : callable
        Seconds.
    report : callable
        Called with a line at every validation.

    Raises
    ------
    FloatingPointError
        If more than a tenth of the updates exploded.
    """
    trainer = DrawnPathTrainer(settings, device=device)
    samples, held_out = (
        PathSamples(*(tensor.to(device) for tensor in vars(s).values()))
        for s in (samples, held_out)
    )
    batches = Batches(samples, motions.to(device), generator=trainer.generator)
    started = validated = clock()
    best = 0.0
    share = 0.0
    while share < 1:
        maps, points = batches.batch(settings.batch, settings.clean)
        loss = trainer.update(maps, points, share=share)
        moment = clock()
        share = (moment - started) / (60 * settings.minutes)
        if trainer.thrown_away > max(20, trainer.step / 10):
            raise FloatingPointError(
                f"rate: {trainer.thrown_away} of {trainer.step} updates exploded at"
                f" {settings.rate:g}; train with a smaller one"
            )
        if moment - validated < validate_s and share < 1:
            continue
        generator = torch.Generator(device).manual_seed(settings.seed)
        result = figures(trainer.average, held_out, draws=4, generator=generator)
        if result.draw + result.best > best:
            best = result.draw + result.best
            card = {"settings": asdict(settings), "step": trainer.step, "figures": asdict(result)}
            tensors = packed(trainer.average.state_dict(), source=target)
            write_with_card(tensors, target, schema=SCHEMA, card=card)
        values = ", ".join(f"{name} {value:.3f}" for name, value in asdict(result).items())
        report(
            f"{trainer.step} updates, {moment - started:.0f} s, loss {loss:.3f},"
            f" {trainer.thrown_away} thrown away; {values}"
        )
        validated = clock()


def _correlation(first: Tensor, second: Tensor) -> Tensor:
    """Correlation (B,) of maps (B, H, W) where they lie."""
    norms = first.flatten(1).norm(dim=1) * second.flatten(1).norm(dim=1)
    correlation: Tensor = (first * second).sum(dim=(1, 2)) / norms.clamp(min=1e-9)
    return correlation


def _blurred(psfs: Tensor) -> Tensor:
    return functional.avg_pool2d(functional.avg_pool2d(psfs[:, None], 3, 1, 1), 3, 1, 1)[:, 0]
