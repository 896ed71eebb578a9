"""Training loop: updates that can stop anywhere and resume exactly."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar, cast

import torch
from torch import Tensor, nn

from motdiff.network.condition import ConditionNetwork
from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import (
    Schedule,
    cosine_schedule,
    denoising_loss,
    dwell_loss,
    q_sample,
    stpd,
    structure_loss,
    to_signal,
)
from motdiff.network.sampling import PathSamples, sample_paths
from motdiff.psf_frame import PSF_PX
from motdiff.training.batches import Batch, BatchSource, seed_of
from motdiff.training.checkpoint import Checkpoint, adam_moments, read_checkpoint, write_checkpoint
from motdiff.training.config import LossConfig, OptimiserConfig, TrainingConfig
from motdiff.training.weight_files import PHOTO_PARTS, load_start

_SMOOTH = 0.95  # decay of the running mean of the loss, over about twenty steps
# seeds other than the batch's: else a motion would get the same noise every time
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
        Running mean of the loss, mostly over the last twenty steps of the whole run.
    """

    total: float
    path: float
    dwell: float
    gradient: float
    smoothed: float


class Trainer:
    """A run: weights, their average, Adam's moments and the step.

    A subclass trains a network of another target over the same condition: it overrides
    ``target``, :meth:`build`, :meth:`losses` and :meth:`draw_psfs`.

    Attributes
    ----------
    target : str
        ``network.target`` of the runs that are trained.
    network : ConditionNetwork
        Being trained.
    average : ConditionNetwork
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

    target: ClassVar[str] = "map"

    def __init__(self, config: TrainingConfig, *, device: str | torch.device = "cpu") -> None:
        if config.network.target != self.target:
            raise ValueError(
                f'network.target: must be "{self.target}", got "{config.network.target}"'
            )
        self.config = config
        self.device = torch.device(device)
        # the caller's global generator stays as it is: a run must not change what follows it
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.optimiser.seed)
            self.network = self.build(config.network)
            self.average = self.build(config.network)
        if config.optimiser.start:
            load_start(self.network, config.optimiser.start)
        self._frozen: list[nn.Module] = []
        if config.optimiser.only == "photo":
            self._frozen = [
                module
                for name, module in self.network.named_children()
                if f"{name}." not in PHOTO_PARTS
            ]
        for module in self._frozen:
            module.requires_grad_(False)
        self.average.load_state_dict(self.network.state_dict())
        for network in (self.network, self.average):
            network.to(self.device)
            # tensor cores take convolutions in this layout without a transposition
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average.eval().requires_grad_(False)
        self.step = 0
        self.seconds = 0.0
        self.loss = math.nan
        self.schedule = cosine_schedule()
        self._adam = torch.optim.Adam(self.network.parameters(), lr=config.optimiser.rate)
        self._rank = int(os.environ.get("RANK", "0"))  # set by torchrun, as WORLD_SIZE
        self._world = int(os.environ.get("WORLD_SIZE", "1"))
        model: nn.Module = self.network
        if self._world > 1:
            model = nn.parallel.DistributedDataParallel(model)
        self.model: Callable[..., Tensor] = model
        if config.optimiser.compile:
            self.model = torch.compile(model)

    def build(self, config: NetworkConfig) -> ConditionNetwork:
        """Build the network with random weights."""
        return MotDiffNetwork(config)

    @property
    def leads(self) -> bool:
        """Whether this process has rank 0, which writes files and prints."""
        return self._rank == 0

    def update(self, source: BatchSource) -> Losses:
        """Do one step; all randomness follows from the seed, the step and the rank."""
        start_s = time.monotonic()
        optimiser = self.config.optimiser
        batch = source.batch(
            self.step, max(1, optimiser.batch // self._world), rank=self._rank
        ).to(self.device)
        for group in self._adam.param_groups:
            group["lr"] = learning_rate(self.step, optimiser)
        self.network.train()
        for module in self._frozen:
            module.eval()  # its running means stay as well
        forked = [self.device] * (self.device.type == "cuda")
        with torch.random.fork_rng(devices=forked):
            torch.manual_seed(seed_of(optimiser.seed, self.step, self._rank, _DROPOUT))
            generator = torch.Generator(self.device)
            generator.manual_seed(seed_of(optimiser.seed, self.step, self._rank, _NOISE))
            with self._precision():
                path, dwell = self.losses(batch, generator)
            total = path + self.config.loss.dwell * dwell
            self._adam.zero_grad(set_to_none=True)
            total.backward()  # type: ignore[no-untyped-call]
        gradient = nn.utils.clip_grad_norm_(self.network.parameters(), optimiser.clip)
        self._adam.step()
        follow(self.average, self.network, old_share=self.config.optimiser.ema, step=self.step)
        self.step += 1
        loss = float(total.detach())
        # checked before a checkpoint can hold the damaged weights
        if not math.isfinite(loss):
            raise FloatingPointError(
                f"the loss became {loss} at step {self.step}; lower optimiser.rate"
            )
        if math.isnan(self.loss):  # the first
            self.loss = loss
        else:
            self.loss = _SMOOTH * self.loss + (1 - _SMOOTH) * loss
        self.seconds += time.monotonic() - start_s
        return Losses(
            loss, float(path.detach()), float(dwell.detach()), float(gradient), self.loss
        )

    def save(self, file: Path | str) -> None:
        """Write the exact state (from the leading process only)."""
        if not self.leads:
            return
        tensors = {f"model.{name}": tensor for name, tensor in self.network.state_dict().items()}
        tensors |= {f"ema.{name}": tensor for name, tensor in self.average.state_dict().items()}
        tensors |= adam_moments(self._adam, self.network)
        tensors["loss"] = torch.tensor(self.loss, dtype=torch.float64)
        write_checkpoint(file, Checkpoint(self.step, tensors, asdict(self.config), self.seconds))

    def resume(self, file: Path | str) -> bool:
        """Restore the state of ``file``, False without one; ValueError for another network's."""
        checkpoint = read_checkpoint(file, device=self.device)
        if checkpoint is None:
            return False
        try:
            self.network.load_state_dict(checkpoint.under("model."))
            self.average.load_state_dict(checkpoint.under("ema."))
        except RuntimeError as error:
            raise ValueError(
                f"{file}: its checkpoint belongs to a network of another configuration"
            ) from error
        checkpoint.restore_adam(self._adam, self.network)
        self.step = checkpoint.step
        self.seconds = checkpoint.seconds
        self.loss = float(checkpoint.tensors["loss"])
        return True

    def losses(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Loss of the path, and of the dwell before its weight."""
        return loss_of(
            self.model,
            batch,
            self.config.loss,
            schedule=self.schedule,
            generator=generator,
            physics_dropout=self.config.data.physics_dropout,
            window=self.config.optimiser.window,
        )

    def draw_psfs(self, batch: Batch, *, steps: int, generator: torch.Generator) -> Tensor:
        """PSF (B, 64, 64) of one draw for each photo, by the averaged weights."""
        return self.draws(batch, steps=steps, generator=generator).psfs()[:, 0]

    def draws(self, batch: Batch, *, steps: int, generator: torch.Generator) -> PathSamples:
        """One draw for each photo, by the averaged weights."""
        network = cast("MotDiffNetwork", self.average)
        return sample_paths(
            network,
            network.condition(batch.photo, batch.physics),
            count=1,
            schedule=self.schedule,
            steps=steps,
            generator=generator,
        )

    def _precision(self) -> torch.autocast | nullcontext[None]:
        if self.config.optimiser.precision == "bf16":
            return torch.autocast(self.device.type, dtype=torch.bfloat16)
        return nullcontext()


@torch.no_grad()
def follow(average: nn.Module, network: nn.Module, *, old_share: float, step: int) -> None:
    """Take a network's weights into their running average, ``step`` updates done before.

    ``old_share`` is that of the old weights, once there are enough of them.
    """
    # early on the average follows fast, as in TensorFlow's ExponentialMovingAverage: else it would
    # remember the random start
    old_share = min(old_share, (1 + step) / (10 + step))
    old, new = ([weights.detach() for weights in net.parameters()] for net in (average, network))
    torch._foreach_lerp_(old, new, 1 - old_share)
    for averaged, buffer in zip(average.buffers(), network.buffers(), strict=True):
        averaged.copy_(buffer)  # batch norm's statistics are running means already


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

    The model, a :class:`MotDiffNetwork`, takes ``(x_t, t, photo, physics)`` to logits; the
    generator is on the batch's device. ``physics_dropout`` is the share of physics maps blanked,
    ``window`` the side of the window of the 64-px field, the same for the whole batch.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, eq. 6 to 8.
    """
    device = batch.x0.device
    size = len(batch.x0)
    pitch = batch.x0.shape[-1] // PSF_PX
    t = torch.randint(schedule.steps, (size,), generator=generator, device=device)
    # eq. 8: pixels are dropped before noising, the target x0 has them all
    signal = to_signal(stpd(batch.x0, loss.stpd, generator))
    eps = torch.randn(signal.shape, generator=generator, device=device)
    physics = blanked(batch.physics, physics_dropout, generator)
    # the mean of two: paths are centred, so windows near the middle hold them oftener
    spread = torch.rand(2, 2, generator=generator, device=device).mean(dim=0)
    row, column = (int(share * (PSF_PX - window) + 0.5) for share in spread.tolist())
    rows, columns = (slice(pitch * first, pitch * (first + window)) for first in (row, column))
    view = (..., rows, columns)
    x0 = batch.x0[view]
    x_t = q_sample(schedule, signal[view], t, eps[view])
    logits = model(x_t, t, batch.photo, physics, (row, column))
    if loss.kind == "structure":
        path = structure_loss(logits[:, :1], x0, path_weight=loss.path_weight, iou=loss.iou)
    else:
        path = denoising_loss(logits[:, :1], x0)
    if logits.shape[1] == 1:
        return path, torch.zeros_like(path)
    return path, dwell_loss(logits[:, 1:], batch.dwell[view], x0)


def blanked(physics: Tensor | None, share: float, generator: torch.Generator) -> Tensor | None:
    """Set a share of the physics maps to 0, each independently."""
    if physics is None or share == 0:
        return physics
    mask = torch.rand(physics.shape[:2], generator=generator, device=physics.device) >= share
    return physics * mask[:, :, None, None]
