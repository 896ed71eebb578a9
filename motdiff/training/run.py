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
from motdiff.network.condition import PHOTO_PX
from motdiff.network.physics_maps import QUICK_STARTS
from motdiff.network.sampling import psfs_of_maps
from motdiff.training.config import TrainingConfig
from motdiff.training.data import Batch, BatchSource, LiveSource, PreparedSource, seed_of
from motdiff.training.log import RunLog
from motdiff.training.loop import Trainer
from motdiff.training.motion_bank import build_bank
from motdiff.training.photos import load_scenes
from motdiff.training.prepared import read_shards
from motdiff.training.samples import Samples

_VALIDATION_SEED = 7  # any, but the same: runs are compared on the same draws
_VALIDATION_BATCH = 32
_SAMPLING_STEPS = 10
_TRIAL_PHOTOS = 2  # timed, to predict how long a validation takes
_SLACK_S = 5.0  # of a last validation beyond the minutes of a piece: its time is an estimate


@dataclass(frozen=True)
class Sources:
    """Training batches, and fixed validation batches of other photos and motions."""

    training: BatchSource
    validation: tuple[Batch, ...]


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
    """Torch's name of the device that ``--device`` asks for, which is made the current one.

    Raises
    ------
    ValueError
        If there is no such device.
    """
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


def make_sources(
    config: TrainingConfig, *, device: torch.device | str = "cpu", workers: int = 1
) -> Sources:
    """Read or simulate the samples of the run.

    Parameters
    ----------
    device : torch.device or str
        Where photos are simulated.
    workers : int
        Processes that draw the bank of motions.

    Raises
    ------
    ValueError
        If the network takes another number of physics maps than there are, or there are too few
        photos.
    """
    data = config.data
    seed = config.optimiser.seed
    inputs = {
        "photo": config.network.backbone != "none",
        "physics": config.network.physics_channels > 0,
    }
    if data.prepared:
        samples = _shards("prepared", data.prepared)
        _check_channels(config, samples.kernels.shape[1])
        held_out = _shards("prepared_validation", data.prepared_validation)
        validation = PreparedSource(held_out, seed=_VALIDATION_SEED, symmetries=False, **inputs)
        count = min(data.validation, len(validation))
        batches = validation.batch(0, count).split(_VALIDATION_BATCH)
        return Sources(
            PreparedSource(samples, seed=seed, **inputs),
            tuple(batch.to(device) for batch in batches),
        )
    _check_channels(config, len(QUICK_STARTS))
    sizes = [
        min(_VALIDATION_BATCH, data.validation - first)
        for first in range(0, data.validation, _VALIDATION_BATCH)
    ]
    least_px = PHOTO_PX + config.photography.margin
    scenes = load_scenes(
        data.photos, held_out=data.held_out, least_px=least_px, device=str(device)
    )
    # other motions and other photos than those of the training
    seeds = (seed, seed_of(seed, _VALIDATION_SEED))
    banks = [
        build_bank(config.motions, count=n, seed=bank_seed, workers=workers).to(device)
        for n, bank_seed in zip((data.motions, data.validation), seeds, strict=True)
    ]
    training, validation_source = (
        LiveSource(bank, photos, config.photography, seed=source_seed, **inputs)
        for bank, photos, source_seed in zip(banks, scenes, (seed, _VALIDATION_SEED), strict=True)
    )
    return Sources(training, tuple(validation_source.batch(i, n) for i, n in enumerate(sizes)))


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

    Parameters
    ----------
    folder : path
        Of ``checkpoint``, ``log.csv`` and ``progress.png``.
    workers : int
        Processes that draw motions.
    trainer_type : type, optional
        Of the network's target.

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
    distributed = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if distributed:
        # nccl has no operations on the CPU
        backends = {"cuda": "nccl"}
        torch.distributed.init_process_group(backends.get(torch.device(device).type, "gloo"))
    try:
        trainer = trainer_type(config, device=device)
        resumed = trainer.resume(target / "checkpoint")
        log = RunLog(target, steps=config.optimiser.steps, enabled=trainer.leads)
        opening = "resumed at" if resumed else "new run, from"
        log.say(f"{opening} step {trainer.step} of {config.optimiser.steps}")
        sources = make_sources(config, device=device, workers=workers)

        validated_s = time.monotonic()

        def due() -> bool:
            return (
                trainer.step % pace.validate_steps == 0 or trainer.step == config.optimiser.steps
            )

        def validate() -> None:
            nonlocal validated_s
            log.validated(
                trainer.step, validation_mnc(trainer, sources.validation), loss=trainer.loss
            )
            validated_s = time.monotonic()

        def overdue() -> bool:
            return time.monotonic() - validated_s >= 60 * pace.validate_minutes

        validated = log.resume(trainer.step, between=not due())
        timed = trainer.leads and math.isfinite(pace.minutes)
        validation_s = 0.0
        if timed:
            validation_s = _validation_time_s(trainer, sources.validation)
        end_s = updates_end_s = start_s + 60 * pace.minutes
        if validation_s <= 0.5 * 60 * pace.minutes:
            updates_end_s -= validation_s
        # a second of them raises KeyboardInterrupt at once
        with _stop_signals() as stop_requested:
            while trainer.step < config.optimiser.steps:
                if trainer.leads and trainer.step and (due() or overdue()) and not validated:
                    validate()
                update_s = time.monotonic()
                losses = trainer.update(sources.training)
                validated = False
                now_s = time.monotonic()
                log.step(
                    trainer.step, losses, batch=config.optimiser.batch, seconds=trainer.seconds
                )
                next_end_s = now_s + (now_s - update_s)
                if due() or overdue():
                    next_end_s += validation_s
                if _any_process(
                    stop_requested() or next_end_s > updates_end_s, device=trainer.device
                ):
                    break
                if now_s - saved_s > pace.save_s:
                    trainer.save(target / "checkpoint")
                    saved_s = time.monotonic()
        trainer.save(target / "checkpoint")
        if trainer.leads and not validated:
            finished = trainer.step == config.optimiser.steps
            if finished or time.monotonic() + validation_s <= end_s + _SLACK_S:
                validate()
            else:
                log.say(
                    f"step {trainer.step}: not validated, which takes about"
                    f" {validation_s / 60:.1f} min"
                )
        if trainer.leads:
            log.close()
    finally:
        if distributed:
            torch.distributed.destroy_process_group()
    return trainer


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
    generator = torch.Generator(trainer.device).manual_seed(_VALIDATION_SEED)
    with torch.no_grad():
        for batch in batches:
            psfs = trainer.draw_psfs(batch, steps=_SAMPLING_STEPS, generator=generator)
            estimates = psfs.double().cpu().numpy()
            truths = psfs_of_maps(batch.dwell[:, 0]).double().cpu().numpy()
            scores += [mnc(*pair) for pair in zip(estimates, truths, strict=True)]
    return np.array(scores)


def _shards(entry: str, folder: str) -> Samples:
    """Read prepared samples; errors name the entry of the run's file."""
    try:
        return read_shards(folder)
    except ValueError as error:
        raise ValueError(f"data.{entry}: {error}") from None


def _check_channels(config: TrainingConfig, kernels: int) -> None:
    maps = 2 + 2 * kernels
    channels = config.network.physics_channels
    if channels not in (0, maps):
        raise ValueError(
            f"network.physics_channels: must be {maps}, as many as there are physics maps, got"
            f" {channels}"
        )


def _any_process(stop: bool, *, device: torch.device) -> bool:
    """Whether any process stops; unless all do after the same step, the others wait for ever."""
    if not torch.distributed.is_initialized():
        return stop
    any_stop = torch.tensor(float(stop), device=device)
    torch.distributed.all_reduce(any_stop, torch.distributed.ReduceOp.MAX)
    return bool(any_stop)


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Hold back the first SIGINT or SIGTERM, so that the step is finished and the state saved."""
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
