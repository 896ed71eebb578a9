"""One piece of a training run: sources, steps, checkpoints and progress."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import torch
from numpy.typing import NDArray

from motdiff.metrics import mnc
from motdiff.network.sampling import psfs_of_maps
from motdiff.training.batches import VALIDATION_SEED, Batch, make_sources
from motdiff.training.config import TrainingConfig
from motdiff.training.log import RunLog
from motdiff.training.trainer import Trainer

_SAMPLING_STEPS = 10
_TRIAL_PHOTOS = 2  # timed, to predict how long a validation takes
_SLACK_S = 5.0  # of a last validation beyond the minutes of a piece: its time is an estimate


@dataclass(frozen=True)
class Pace:
    """How long one piece lasts, and how often it saves and validates.

    Attributes
    ----------
    minutes : float
        The piece ends after so many (and goes on with the next call), at least one update done.
        They count everything: reading or simulating samples, updates, and the validation at the
        end, which is left out where it would take more than half of them.
    save_s : float, seconds
        Between two checkpoints.
    validate_steps : int
        Updates between two validations.
    validate_minutes : float
        The longest time without a validation while updates go on.
    """

    minutes: float = float("inf")
    save_s: float = 60.0
    validate_steps: int = 1000
    validate_minutes: float = float("inf")

    def __post_init__(self) -> None:
        for name in ("minutes", "save_s", "validate_minutes"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if self.validate_steps < 1:
            raise ValueError(f"validate_steps: must be at least 1, got {self.validate_steps}")


def device_named(option: str) -> str:
    """Make the device of ``--device`` the current one, and name it; ValueError without it."""
    name = option or ("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda":
        name = f"cuda:{os.environ.get('LOCAL_RANK', '0')}"  # torchrun's: one GPU for each process
    kind, _, number = name.partition(":")
    if kind not in ("cpu", "cuda") or (number and not number.isdecimal()):
        raise ValueError(f"--device: must be cpu, cuda or cuda:NUMBER, got {option!r}")
    if kind == "cuda":
        if int(number) >= torch.cuda.device_count():
            raise ValueError(f"--device: there is no GPU {name} here, use --device cpu")
        torch.cuda.set_device(name)
    return name


def train(
    config: TrainingConfig,
    folder: Path | str,
    *,
    device: str | torch.device = "cpu",
    pace: Pace | None = None,
    workers: int = 1,
    trainer_type: type[Trainer] = Trainer,
) -> Trainer:
    """Train, or go on, until the configured steps are done, the time is up, or a signal comes.

    The folder is that of ``checkpoint``, ``log.csv`` and ``progress.png``; ``workers`` processes
    draw motions; the type of the trainer is that of the network's target.

    Raises
    ------
    ValueError
        If the photos or samples are not there or do not fit the network, or ``folder`` holds a run
        of another network.
    FloatingPointError
        If the loss is no longer finite.
    """
    start_s = saved_s = time.monotonic()
    pace = pace or Pace()
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with _process_group(device):
        trainer = trainer_type(config, device=device)
        resumed = trainer.resume(target / "checkpoint")
        log = RunLog(target, steps=config.optimiser.steps, enabled=trainer.leads)
        opening = "resumed at" if resumed else "new run, from"
        log.say(f"{opening} step {trainer.step} of {config.optimiser.steps}")
        sources = make_sources(config, device=device, workers=workers)
        validation = _Validation(trainer, sources.validation, log, pace)
        end_s = updates_end_s = start_s + 60 * pace.minutes
        if validation.takes_s <= 0.5 * 60 * pace.minutes:
            updates_end_s -= validation.takes_s
        with _stop_signals() as stop_requested:
            while trainer.step < config.optimiser.steps:
                if trainer.leads and trainer.step and validation.due and not validation.done:
                    validation.run()
                update_s = time.monotonic()
                losses = trainer.update(sources.training)
                now_s = time.monotonic()
                log.step(
                    trainer.step, losses, batch=config.optimiser.batch, seconds=trainer.seconds
                )
                next_end_s = now_s + (now_s - update_s)
                if validation.due:
                    next_end_s += validation.takes_s
                if _any_process(
                    stop_requested() or next_end_s > updates_end_s, device=trainer.device
                ):
                    break
                if now_s - saved_s > pace.save_s:
                    trainer.save(target / "checkpoint")
                    saved_s = time.monotonic()
        trainer.save(target / "checkpoint")
        if trainer.leads:
            if not validation.done:
                validation.run_last(end_s)
            log.close()
    return trainer


class _Validation:
    """Validations of a piece of a run.

    Attributes
    ----------
    takes_s : float, seconds
        Predicted where the piece has a limit of time, else 0.
    """

    def __init__(
        self, trainer: Trainer, batches: tuple[Batch, ...], log: RunLog, pace: Pace
    ) -> None:
        self._trainer = trainer
        self._batches = batches
        self._log = log
        self._pace = pace
        self._last_s = time.monotonic()
        is_validated = log.resume(trainer.step, scheduled=self._has_its_step)
        self._validated_step = trainer.step if is_validated else -1
        self.takes_s = 0.0
        if trainer.leads and math.isfinite(pace.minutes):
            self.takes_s = _validation_time_s(trainer, batches)

    @property
    def due(self) -> bool:
        """Whether the step, or the time since the last one, calls for a validation."""
        overdue = time.monotonic() - self._last_s >= 60 * self._pace.validate_minutes
        return self._has_its_step or overdue

    @property
    def done(self) -> bool:
        """Whether an earlier piece validated the weights as they are."""
        return self._trainer.step == self._validated_step

    @property
    def _has_its_step(self) -> bool:
        step = self._trainer.step
        return step % self._pace.validate_steps == 0 or self._finished

    @property
    def _finished(self) -> bool:
        return self._trainer.step == self._trainer.config.optimiser.steps

    def run(self) -> None:
        """Validate, and log the score."""
        score = validation_mnc(self._trainer, self._batches)
        self._log.validated(self._trainer.step, score, loss=self._trainer.loss)
        self._last_s = time.monotonic()

    def run_last(self, end_s: float) -> None:
        """Validate at the end of a piece, unless that would take too long."""
        if self._finished or time.monotonic() + self.takes_s <= end_s + _SLACK_S:
            self.run()
        else:
            self._log.say(
                f"step {self._trainer.step}: not validated, which takes about"
                f" {self.takes_s / 60:.1f} min"
            )


def _validation_time_s(trainer: Trainer, batches: tuple[Batch, ...]) -> float:
    """Time of a validation, predicted from a few photos."""
    trial = batches[0].split(_TRIAL_PHOTOS)[0]
    times_s = []
    for _ in range(2):  # the first may load code
        start_s = time.monotonic()
        validation_scores(trainer, (trial,))
        times_s.append(time.monotonic() - start_s)
    return min(times_s) * sum(map(len, batches)) / len(trial)


def validation_mnc(trainer: Trainer, batches: tuple[Batch, ...]) -> float:
    """Mean of :func:`validation_scores`; for comparing runs, not for reports."""
    return float(validation_scores(trainer, batches).mean())


def validation_scores(trainer: Trainer, batches: tuple[Batch, ...]) -> NDArray[np.float64]:
    """MNC (N,), whole-pixel shifts, of one draw per photo by the averaged weights.

    The truth is the time-weighted HR map's own PSF.
    """
    scores: list[float] = []
    generator = torch.Generator(trainer.device).manual_seed(VALIDATION_SEED)
    with torch.no_grad():
        for batch in batches:
            psfs = trainer.draw_psfs(batch, steps=_SAMPLING_STEPS, generator=generator)
            estimates = psfs.double().cpu().numpy()
            truths = psfs_of_maps(batch.dwell[:, 0]).double().cpu().numpy()
            scores += [mnc(*pair) for pair in zip(estimates, truths, strict=True)]
    return np.array(scores)


@contextmanager
def _process_group(device: str | torch.device) -> Iterator[None]:
    """Join the processes that torchrun started, where there are several."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield
        return
    # nccl has no operations on the CPU
    backend = "nccl" if torch.device(device).type == "cuda" else "gloo"
    torch.distributed.init_process_group(backend)
    try:
        yield
    finally:
        torch.distributed.destroy_process_group()


def _any_process(stop: bool, *, device: torch.device) -> bool:
    """Whether any process stops; unless all do after the same step, the others wait for ever."""
    if not torch.distributed.is_initialized():
        return stop
    any_stop = torch.tensor(float(stop), device=device)
    torch.distributed.all_reduce(any_stop, torch.distributed.ReduceOp.MAX)
    return bool(any_stop)


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Hold back the first SIGINT or SIGTERM, so that the step is finished and the state saved.

    A second one raises KeyboardInterrupt at once.
    """
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        if received:
            raise KeyboardInterrupt
        received.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
