"""Training of the correction, and the MNC of corrected kernels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from lab.trainings.averaged import AveragedNetwork, set_rate
from lab.trainings.correction.samples import Kernels, alike, described
from motdiff.blind_search.grids import SYMMETRIES, mirrored
from motdiff.network.correction import CorrectionNetwork, corrected
from motdiff.training.samples import Samples
from motdiff.weights import CORRECTION_SCHEMA
from motdiff.weights_io import packed, write_with_card

_EVALUATED = 256  # kernels at a time
_WARM_UP_STEPS = 100
_LONGEST_GRADIENT = 1.0
_AVERAGED = 0.998  # share of the old weights in the running average, once there are enough of them
_DECAY = 1e-2
_SECOND_PASS = 0.4  # share of the updates after which corrected kernels take part as well


@dataclass(frozen=True)
class Settings:
    """Settings of a run: updates, kernels in each, AdamW's step size, and the seed."""

    steps: int = 2500
    batch: int = 512
    rate: float = 1.5e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: must be at least 1, got {getattr(self, name)}")


class CorrectionTrainer(AveragedNetwork[CorrectionNetwork]):
    """Network, its optimiser, and the running average of its weights, which is exported.

    Parameters
    ----------
    settings : Settings
    device : str
    """

    def __init__(self, settings: Settings, *, device: str = "cpu") -> None:
        super().__init__(CorrectionNetwork, seed=settings.seed, device=device, old_share=_AVERAGED)
        self.settings = settings
        self._adam = torch.optim.AdamW(
            self.network.parameters(), lr=settings.rate, weight_decay=_DECAY
        )
        self._generator = torch.Generator().manual_seed(settings.seed)

    def update(self, *passes: Kernels) -> float:
        """Make one update on kernels of one pass or both; returns the loss, 1 - MNC before
        negative values are cut.

        Raises
        ------
        FloatingPointError
            If the loss is not finite.
        """
        cosine = 0.5 * (1 + math.cos(math.pi * self.step / self.settings.steps))
        warm_up = min(1.0, (self.step + 1) / _WARM_UP_STEPS)
        set_rate(self._adam, self.settings.rate * warm_up * cosine)
        maps, truth = self._batch(passes)
        with self.single_or_bf16():
            estimates = self.network(maps)
        loss = (1 - alike(estimates.float(), truth)).mean()
        if not loss.isfinite():
            raise FloatingPointError(
                f"loss: is {float(loss.detach())} at step {self.step}; train with a smaller rate"
            )
        self._adam.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._adam.step()
        self.advance()
        return float(loss.detach())

    def _batch(self, passes: Sequence[Kernels]) -> tuple[Tensor, Tensor]:
        """Draw maps (B, 11, 64, 64) and true PSFs (B, 64, 64) at random, all turned or mirrored
        the same way.
        """
        draw = self._generator
        count = max(1, self.settings.batch // len(passes))
        batches = [
            (kernels.maps[index], kernels.truth[index])
            for kernels in passes
            for index in [torch.randint(len(kernels), (count,), generator=draw)]
        ]
        maps, truth = (torch.cat(tensors).float() for tensors in zip(*batches, strict=True))
        symmetry, swapped = (int(torch.randint(n, (1,), generator=draw)) for n in (SYMMETRIES, 2))
        if swapped:  # the two other kernels have no order
            maps = maps[:, [0, 2, 1, *range(3, maps.shape[1])]]
        return mirrored(maps, symmetry, pitch=1), mirrored(truth[:, None], symmetry, pitch=1)[:, 0]


def train(
    samples: Samples,
    target: Path | str,
    *,
    settings: Settings = Settings(),
    device: str = "cpu",
    save_s: float = 60.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> None:
    """Train on searched kernels, and after a while on those as well that the network corrected.

    Parameters
    ----------
    samples : Samples
        From :func:`~lab.trainings.correction.samples.read_samples`.
    target : path
        Weights file, written every ``save_s`` seconds and at the end, whole each time.
    settings : Settings
    device : str
    save_s : float
        Seconds between files.
    clock : callable
        Seconds.
    report : callable
        Called with a line of progress at every file.
    """
    trainer = CorrectionTrainer(settings, device=device)
    passes = [described(samples, device=device)]
    started = saved = clock()
    while trainer.step < settings.steps:
        if len(passes) == 1 and trainer.step >= _SECOND_PASS * settings.steps:
            passes.append(described(samples, network=trainer.average, device=device))
        loss = trainer.update(*passes)
        moment = clock()
        if moment - saved >= save_s or trainer.step == settings.steps:
            about = {
                "kernels": len(passes[0]),
                "steps": trainer.step,
                "seconds": round(moment - started),
                "device": device,
            }
            write_with_card(
                packed(trainer.average.state_dict(), source=target),
                target,
                schema=CORRECTION_SCHEMA,
                card={**about, "settings": asdict(settings)},
            )
            report(
                f"{trainer.step} of {settings.steps} updates, {moment - started:.0f} s,"
                f" loss {loss:.4f}"
            )
            saved = moment


def corrected_mnc(
    samples: Samples, network: CorrectionNetwork, *, device: str = "cpu"
) -> tuple[float, float, float]:
    """Mean MNC of the searched kernels, and of these after one and after two corrections.

    Lost kernels are left out of each.
    """
    mean_mnc = []
    network = network.to(device)
    for first_pass in (None, network):
        kernels = described(samples, network=first_pass, device=device)
        before, after = [], []
        with torch.no_grad():
            for first in range(0, len(kernels), _EVALUATED):
                batch = slice(first, first + _EVALUATED)
                maps, truth = (t[batch].float() for t in (kernels.maps, kernels.truth))
                before.append(alike(maps[:, 0], truth))
                after.append(alike(corrected(network, maps), truth))
        mean_mnc += [float(torch.cat(before).mean()), float(torch.cat(after).mean())]
    return mean_mnc[0], mean_mnc[1], mean_mnc[3]
