"""Training loop: updates that can stop anywhere and resume exactly."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from motdiff.network import build_network
from motdiff.network.diffusion import (
    Schedule,
    cosine_schedule,
    q_sample,
    stochastic_trajectory_pixel_dropout,
    to_signal,
)
from motdiff.network.losses import denoising_loss, dwell_loss, structure_loss
from motdiff.psf_frame import PSF_PX
from motdiff.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from motdiff.training.config import LossConfig, OptimiserConfig, TrainingConfig
from motdiff.training.data import Batch, BatchSource, seed_of
from motdiff.training.targets import path_loss, psf_batch
from motdiff.weights import PHOTO_PARTS, load_start

_BETAS = (0.9, 0.999)
_SMOOTH = 0.95
# seeds of their own, and not the batch's: else a motion would meet the same noise every time
_NOISE = 3
_DROPOUT = 4


@dataclass(frozen=True)
class Losses:
    """Losses of one update.

    Attributes
    ----------
    total, path, dwell : float
        Loss minimised, its path part, and the dwell part before its weight.
    gradient : float
        Norm of the gradient before clipping.
    smoothed : float
        Running mean of the loss over the steps of the whole run so far, mostly over the last
        twenty.
    """

    total: float
    path: float
    dwell: float
    gradient: float
    smoothed: float


class Trainer:
    """A run: weights, their average, Adam's moments and the step.

    Parameters
    ----------
    config : TrainingConfig
    device : str or torch.device

    Attributes
    ----------
    network : MotDiffNetwork or PathNetwork
        Being trained.
    average : MotDiffNetwork or PathNetwork
        Exponential average of its weights: the one to use.
    step : int
        Updates done.
    seconds : float
        Time spent on them, over all pieces of the run.
    loss : float
        Smoothed over them, NaN before the first.
    schedule : Schedule
        Of the noise.
    """

    def __init__(self, config: TrainingConfig, *, device: str | torch.device = "cpu") -> None:
        self.config = config
        self.device = torch.device(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.optimiser.seed)
            self.network = build_network(config.network)
            self.average = build_network(config.network)
        if config.optimiser.start:
            load_start(self.network, config.optimiser.start)
        kept = [
            part for name, part in self.network.named_children() if f"{name}." not in PHOTO_PARTS
        ]
        self._kept = kept if config.optimiser.only == "photo" else []
        for part in self._kept:
            part.requires_grad_(False)
        self.average.load_state_dict(self.network.state_dict())
        for mine in (self.network, self.average):
            mine.to(self.device)
            mine.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average.eval().requires_grad_(False)
        self.step = 0
        self.seconds = 0.0
        self.loss = math.nan
        self.schedule = cosine_schedule()
        self._adam = torch.optim.Adam(
            self.network.parameters(), lr=config.optimiser.rate, betas=_BETAS
        )
        self._rank = int(os.environ.get("RANK", "0"))
        self._world = int(os.environ.get("WORLD_SIZE", "1"))
        model: nn.Module = self.network
        if self._world > 1:
            model = nn.parallel.DistributedDataParallel(model)
        self._model: Callable[..., Tensor] = (
            torch.compile(model) if config.optimiser.compile else model
        )

    @property
    def leads(self) -> bool:
        """Whether this process has rank 0, which writes files and prints."""
        return self._rank == 0

    def update(self, source: BatchSource) -> Losses:
        """Do one step.

        Everything random in it follows from the seed, the step and the rank, so nothing of it
        needs to be stored.
        """
        began = time.monotonic()
        optimiser = self.config.optimiser
        batch = source.batch(
            self.step, max(1, optimiser.batch // self._world), rank=self._rank
        ).to(self.device)
        for group in self._adam.param_groups:
            group["lr"] = learning_rate(self.step, optimiser)
        self.network.train()
        for part in self._kept:
            part.eval()  # its running means stay as well
        forked = [self.device] if self.device.type == "cuda" else []
        with torch.random.fork_rng(devices=forked):
            torch.manual_seed(seed_of(optimiser.seed, self.step, self._rank, _DROPOUT))
            generator = torch.Generator(self.device)
            generator.manual_seed(seed_of(optimiser.seed, self.step, self._rank, _NOISE))
            with self._precision():
                path, dwell = self._losses(batch, generator)
            total = path + self.config.loss.dwell * dwell
            self._adam.zero_grad(set_to_none=True)
            total.backward()  # type: ignore[no-untyped-call]
        gradient = nn.utils.clip_grad_norm_(self.network.parameters(), optimiser.clip)
        self._adam.step()
        self._average()
        self.step += 1
        loss = float(total.detach())
        if not math.isfinite(loss):
            raise FloatingPointError(
                f"the loss became {loss} at step {self.step}; lower optimiser.rate"
            )
        self.loss = loss if math.isnan(self.loss) else _SMOOTH * self.loss + (1 - _SMOOTH) * loss
        self.seconds += time.monotonic() - began
        return Losses(
            loss, float(path.detach()), float(dwell.detach()), float(gradient), self.loss
        )

    def save(self, folder: Path | str) -> None:
        """Write the exact state (from the leading process only)."""
        if not self.leads:
            return
        tensors = {f"model.{name}": tensor for name, tensor in self.network.state_dict().items()}
        tensors |= {f"ema.{name}": tensor for name, tensor in self.average.state_dict().items()}
        for name, parameter in self.network.named_parameters():
            state = self._adam.state.get(parameter, {})
            tensors |= {
                f"adam.{key}.{name}": state[key]
                for key in ("exp_avg", "exp_avg_sq")
                if key in state
            }
        tensors["loss"] = torch.tensor(self.loss, dtype=torch.float64)
        write_checkpoint(
            folder, Checkpoint(self.step, tensors, self.config.as_dict(), self.seconds)
        )

    def resume(self, folder: Path | str) -> bool:
        """Take up the state of ``folder``; False where there is none.

        Raises
        ------
        ValueError
            If it belongs to another network.
        """
        checkpoint = read_checkpoint(folder, device=self.device)
        if checkpoint is None:
            return False
        try:
            self.network.load_state_dict(checkpoint.part("model."))
            self.average.load_state_dict(checkpoint.part("ema."))
        except RuntimeError as error:
            raise ValueError(
                f"{folder}: its checkpoint belongs to a network of another configuration"
            ) from error
        first = checkpoint.part("adam.exp_avg.")
        second = checkpoint.part("adam.exp_avg_sq.")
        for name, parameter in self.network.named_parameters():
            if name in first:
                self._adam.state[parameter] = {
                    "step": torch.tensor(float(checkpoint.step)),
                    "exp_avg": torch.empty_like(parameter).copy_(
                        first[name]
                    ),  # laid out as the parameter is
                    "exp_avg_sq": torch.empty_like(parameter).copy_(second[name]),
                }
        self.step = checkpoint.step
        self.seconds = checkpoint.seconds
        self.loss = float(
            checkpoint.tensors.get("loss", math.nan)
        )  # earlier versions did not keep it
        return True

    def _losses(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        target = self.config.network.target
        blank = self.config.data.physics_dropout
        if target == "path":
            physics = _blanked(batch.physics, blank, generator)
            loss = path_loss(self._model(batch.photo, physics).float(), batch.dwell)
            return loss, torch.zeros_like(loss)
        return loss_of(
            self._model,
            psf_batch(batch) if target == "psf" else batch,
            self.config.loss,
            schedule=self.schedule,
            generator=generator,
            physics_dropout=blank,
            window=self.config.optimiser.window,
        )

    def _precision(self) -> torch.autocast | nullcontext[None]:
        if self.config.optimiser.precision == "bf16":
            return torch.autocast(self.device.type, dtype=torch.bfloat16)
        return nullcontext()

    @torch.no_grad()
    def _average(self) -> None:
        # early on the average follows fast, as it would otherwise remember the random start
        decay = min(self.config.optimiser.ema, (1 + self.step) / (10 + self.step))
        mine = [parameter.detach() for parameter in self.average.parameters()]
        torch._foreach_lerp_(
            mine, [parameter.detach() for parameter in self.network.parameters()], 1 - decay
        )
        for kept, now in zip(self.average.buffers(), self.network.buffers(), strict=True):
            kept.copy_(now)


def learning_rate(step: int, optimiser: OptimiserConfig) -> float:
    """Rate of a step: a linear rise, then half a cosine from ``rate`` to ``last_rate``."""
    if step < optimiser.warm_up:
        return optimiser.rate * (step + 1) / optimiser.warm_up
    share = min(1.0, (step - optimiser.warm_up) / max(1, optimiser.steps - optimiser.warm_up))
    return optimiser.last_rate + (optimiser.rate - optimiser.last_rate) * 0.5 * (
        1 + math.cos(math.pi * share)
    )


def loss_of(
    model: Callable[..., Tensor],
    batch: Batch,
    loss: LossConfig,
    *,
    schedule: Schedule,
    generator: torch.Generator,
    physics_dropout: float = 0.0,
    window: int = PSF_PX,
) -> tuple[Tensor, Tensor]:
    """Path loss and dwell loss of a batch at uniformly drawn timesteps.

    Parameters
    ----------
    model : callable
        ``model(x_t, t, photo, physics)`` to logits, a :class:`MotDiffNetwork`.
    batch : Batch
    loss : LossConfig
    schedule : Schedule
    generator : torch.Generator
        On the batch's device.
    physics_dropout : float
        Share of physics maps blanked.
    window : int
        Side of the used part of the 64-px field, the same for the whole batch.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equations 6 to 8: pixels are dropped before noising,
    the target is whole.
    """
    device = batch.x0.device
    size = len(batch.x0)
    pitch = batch.x0.shape[-1] // PSF_PX
    t = torch.randint(schedule.steps, (size,), generator=generator, device=device)
    signal = to_signal(stochastic_trajectory_pixel_dropout(batch.x0, loss.stpd, generator))
    noise = torch.randn(signal.shape, generator=generator, device=device)
    physics = _blanked(batch.physics, physics_dropout, generator)
    # paths are centred: windows near the middle see them oftener
    spread = torch.rand(2, 2, generator=generator, device=device).mean(dim=0)
    row, column = (int(share * (PSF_PX - window) + 0.5) for share in spread.tolist())
    rows, columns = (slice(pitch * first, pitch * (first + window)) for first in (row, column))
    part = (..., rows, columns)
    x0 = batch.x0[part]
    dwell_map = batch.dwell[part]
    logits = model(
        q_sample(schedule, signal[part], t, noise[part]), t, batch.photo, physics, (row, column)
    )
    if loss.kind == "structure":
        path = structure_loss(logits[:, :1], x0, path_weight=loss.path_weight, iou=loss.iou)
    else:
        path = denoising_loss(logits[:, :1], x0)
    dwell = (
        dwell_loss(logits[:, 1:], dwell_map, x0) if logits.shape[1] > 1 else torch.zeros_like(path)
    )
    return path, dwell


def _blanked(physics: Tensor | None, share: float, generator: torch.Generator) -> Tensor | None:
    """Set a share of the physics maps to 0, each by itself."""
    if physics is None or share == 0:
        return physics
    kept = torch.rand(physics.shape[:2], generator=generator, device=physics.device) >= share
    return physics * kept[:, :, None, None]
