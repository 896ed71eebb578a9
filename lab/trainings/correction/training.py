"""Training of the correction, and the MNC of corrected kernels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from lab.trainings.correction.samples import Kernels, alike
from motdiff.network.correction import CorrectionNetwork, corrected
from motdiff.network.symmetry import SYMMETRIES, mirrored
from motdiff.weights.correction import write_correction

_WARM_UP_STEPS = 50
_LONGEST_GRADIENT = 1.0
_AVERAGED = 0.997  # share of the old weights in the running average, once there are enough of them
_DECAY = 1e-2


@dataclass(frozen=True)
class Settings:
    """Settings of a run: updates, kernels in each, AdamW's step size, and the seed."""

    steps: int = 5000
    batch: int = 16
    rate: float = 1.5e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: must be at least 1, got {getattr(self, name)}")


class Trainer:
    """Network, its optimiser, and the running average of its weights, which is exported.

    Parameters
    ----------
    kernels : Kernels
    settings : Settings
    """

    def __init__(self, kernels: Kernels, settings: Settings) -> None:
        self.settings = settings
        self._kernels = kernels
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.network = CorrectionNetwork()
        self._adam = torch.optim.AdamW(
            self.network.parameters(), lr=settings.rate, weight_decay=_DECAY
        )
        self._generator = torch.Generator().manual_seed(settings.seed)
        self.average: dict[str, Tensor] = {
            name: value.clone() for name, value in self.network.state_dict().items()
        }
        self.step = 0

    def update(self) -> float:
        """Make one update; returns the loss, 1 - MNC before negative values are cut.

        Raises
        ------
        FloatingPointError
            If the loss is not finite.
        """
        cosine = 0.5 * (1 + math.cos(math.pi * self.step / self.settings.steps))
        for group in self._adam.param_groups:
            group["lr"] = self.settings.rate * min(1.0, (self.step + 1) / _WARM_UP_STEPS) * cosine
        maps, truth = self._batch()
        loss = (1 - alike(self.network(maps), truth)).mean()
        if not loss.isfinite():
            raise FloatingPointError(
                f"loss: is {float(loss.detach())} at step {self.step}; train with a smaller rate"
            )
        self._adam.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._adam.step()
        decay = min(_AVERAGED, (self.step + 1) / (self.step + 10))
        for name, value in self.network.state_dict().items():
            self.average[name].lerp_(value, 1 - decay)
        self.step += 1
        return float(loss.detach())

    def _batch(self) -> tuple[Tensor, Tensor]:
        """Draw maps (B, 11, 64, 64) and true PSFs (B, 64, 64) at random, all turned or mirrored
        the same way.
        """
        index = torch.randint(
            len(self._kernels), (self.settings.batch,), generator=self._generator
        )
        symmetry, swapped = (
            int(torch.randint(n, (1,), generator=self._generator)) for n in (SYMMETRIES, 2)
        )
        maps = self._kernels.maps[index].float()
        truth = self._kernels.truth[index].float()
        if swapped:  # the two other kernels have no order
            maps = maps[:, [0, 2, 1, *range(3, maps.shape[1])]]
        return mirrored(maps, symmetry, pitch=1), mirrored(truth[:, None], symmetry, pitch=1)[:, 0]


def train(
    kernels: Kernels,
    target: Path | str,
    *,
    settings: Settings = Settings(),
    save_s: float = 120.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> None:
    """Train on the kernels.

    Parameters
    ----------
    kernels : Kernels
    target : path
        Weights file, written every ``save_s`` seconds and at the end, whole each time.
    settings : Settings
    save_s : float
        Seconds between files.
    clock : callable
        Seconds.
    report : callable
        Called with a line of progress at every file.
    """
    trainer = Trainer(kernels, settings)
    started = saved = clock()
    while trainer.step < settings.steps:
        loss = trainer.update()
        moment = clock()
        if moment - saved >= save_s or trainer.step == settings.steps:
            about = {
                "kernels": len(kernels),
                "steps": trainer.step,
                "seconds": round(moment - started),
            }
            write_correction(
                trainer.average, target, about={**about, "settings": asdict(settings)}
            )
            report(
                f"{trainer.step} of {settings.steps} updates, {moment - started:.0f} s,"
                f" loss {loss:.4f}"
            )
            saved = moment


def corrected_mnc(kernels: Kernels, network: CorrectionNetwork) -> tuple[float, float]:
    """Mean MNC of the kernels before and after their correction."""
    pairs = []
    with torch.no_grad():
        for maps, truth in zip(
            torch.split(kernels.maps, 1), torch.split(kernels.truth, 1), strict=True
        ):
            corrected_kernels = corrected(network, maps.float())
            pairs.append(
                torch.cat(
                    [
                        alike(estimate, truth.float())
                        for estimate in (maps[:, 0].float(), corrected_kernels)
                    ]
                )
            )
    before, after = torch.stack(pairs).mean(dim=0).tolist()
    return before, after
