"""Training of the denoiser, paced by the clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from cep.restoration.denoiser.network import DenoisingNetwork
from cep.restoration.denoiser.weights import write_weights
from lab.trainings.denoiser.samples import Batch, draw

_WARM_UP_STEPS = 100
_LAST_RATE = 0.01  # of the first, at the end of the cosine
_LONGEST_GRADIENT = 0.5
_AVERAGED = 0.998  # share of the old weights in the running average, once there are enough of them


@dataclass(frozen=True)
class Settings:
    """Settings of a run: crops per update, their side, Adam's step size, and the seed."""

    batch: int = 5
    crop_px: int = 96
    rate: float = 1.2e-3
    seed: int = 0


class Trainer:
    """Network, its optimiser, and the running average of its weights, which is exported.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.network = DenoisingNetwork()
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._adam = torch.optim.Adam(self.network.parameters(), lr=settings.rate)
        self.average: dict[str, Tensor] = {
            name: value.clone() for name, value in self.network.state_dict().items()
        }
        self.step = 0

    def update(self, batch: Batch, *, progress: float) -> float:
        """Make one update at a share ``progress`` of the run, 0..1; returns the loss.

        The loss is the mean error over the square root of the noise level: all levels have about
        the same weight.

        Raises
        ------
        FloatingPointError
            If the loss is not finite.
        """
        cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        rate = min(1.0, (self.step + 1) / _WARM_UP_STEPS) * (
            _LAST_RATE + (1 - _LAST_RATE) * cosine
        )
        for group in self._adam.param_groups:
            group["lr"] = self.settings.rate * rate
        error = (self.network(batch.noisy, batch.sigma) - batch.clean).abs().mean(dim=(1, 2, 3))
        loss = (error / batch.sigma.sqrt()).mean()
        if not loss.isfinite():
            raise FloatingPointError(
                f"loss: is {float(loss.detach())} at step {self.step}; train with a smaller rate"
            )
        self._adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._adam.step()
        decay = min(_AVERAGED, (self.step + 1) / (self.step + 10))
        for name, value in self.network.state_dict().items():
            self.average[name].lerp_(value, 1 - decay)
        self.step += 1
        return float(loss.detach())


def train(
    photos: Sequence[Tensor],
    target: Path | str,
    *,
    minutes: float,
    settings: Settings = Settings(),
    save_s: float = 60.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> int:
    """Train for so many minutes; returns the number of updates.

    Parameters
    ----------
    photos : sequence of (3, H, W) uint8 tensors, display values
    target : path
        Weights file, written every ``save_s`` seconds and at the end, whole each time.
    minutes : float
        Length of the run; it sets the pace at which the step size falls.
    settings : Settings
    save_s : float
        Seconds between files.
    clock : callable
        Seconds.
    report : callable
        Called with a line of progress at every file.

    Raises
    ------
    ValueError
        If ``minutes`` is not above 0 or a photo is smaller than the crops.
    """
    if not 0 < minutes < math.inf:
        raise ValueError(f"minutes: must be above 0, got {minutes}")
    trainer = Trainer(settings)
    started = saved = moment = clock()
    while moment - started < 60 * minutes:
        batch = draw(
            photos,
            trainer.step,
            count=settings.batch,
            side_px=settings.crop_px,
            seed=settings.seed,
        )
        loss = trainer.update(batch, progress=(moment - started) / (60 * minutes))
        moment = clock()
        if moment - saved >= save_s or moment - started >= 60 * minutes:
            about = {
                "steps": trainer.step,
                "seconds": round(moment - started),
                "settings": asdict(settings),
            }
            write_weights(trainer.average, target, about=about)
            report(f"{trainer.step} updates, {moment - started:.0f} s, loss {loss:.4f}")
            saved = moment
    return trainer.step
