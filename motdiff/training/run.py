"""One piece of a training run: sources, steps, checkpoints, progress; it ends by steps, time or a
signal.
"""

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
from motdiff.training.targets import drawn_psfs

_VALIDATION_SEED = 7
_VALIDATION_BATCH = 32
_SAMPLING_STEPS = 10
_TRIAL_PHOTOS = 2
_SLACK_S = 5.0  # by which a last validation may exceed the minutes of a piece


@dataclass(frozen=True)
class Sources:
    """Batches to learn from, and the fixed ones to validate on, of other photos and other
    motions.
    """

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
    """

    minutes: float = float("inf")
    save_s: float = 60.0
    validate_steps: int = 1000

    def __post_init__(self) -> None:
        for name in ("minutes", "save_s"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if self.validate_steps < 1:
            raise ValueError(f"validate_steps: must be at least 1, got {self.validate_steps}")


def make_sources(
    config: TrainingConfig, *, device: torch.device | str = "cpu", workers: int = 1
) -> Sources:
    """Read or simulate the samples of the run.

    Parameters
    ----------
    config : TrainingConfig
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
    wanted = {
        "photo": config.network.backbone != "none",
        "physics": config.network.physics_channels > 0,
    }
    if data.prepared:
        known = _shards("prepared", data.prepared)
        _check_channels(config, known.kernels.shape[1])
        held_out = _shards("prepared_validation", data.prepared_validation)
        kept = PreparedSource(held_out, seed=_VALIDATION_SEED, symmetries=False, **wanted)
        fixed = kept.batch(0, min(data.validation, len(kept))).split(_VALIDATION_BATCH)
        return Sources(
            PreparedSource(known, seed=seed, **wanted), tuple(batch.to(device) for batch in fixed)
        )
    _check_channels(config, len(QUICK_STARTS))
    chunks = [
        min(_VALIDATION_BATCH, data.validation - first)
        for first in range(0, data.validation, _VALIDATION_BATCH)
    ]
    least_px = PHOTO_PX + config.photography.margin
    seen, unseen = load_scenes(
        data.photos, held_out=data.held_out, least_px=least_px, device=str(device)
    )
    bank = build_bank(config.motions, count=data.motions, seed=seed, workers=workers).to(device)
    other = build_bank(
        config.motions,
        count=data.validation,
        seed=seed_of(seed, _VALIDATION_SEED),
        workers=workers,
    )
    check = LiveSource(
        other.to(device), unseen, config.photography, seed=_VALIDATION_SEED, **wanted
    )
    return Sources(
        LiveSource(bank, seen, config.photography, seed=seed, **wanted),
        tuple(check.batch(i, n) for i, n in enumerate(chunks)),
    )


def train(
    config: TrainingConfig,
    folder: Path | str,
    *,
    device: str | torch.device = "cpu",
    pace: Pace | None = None,
    workers: int = 1,
) -> Trainer:
    """Train, or go on training, until the configured steps are done, the time is up, or a signal
    asks to stop.

    Parameters
    ----------
    config : TrainingConfig
    folder : path
        Holds ``checkpoint/``, ``log.csv`` and ``progress.png``.
    device : str
    pace : Pace, optional
    workers : int
        Processes that draw motions.

    Raises
    ------
    ValueError
        If the photos or samples are not there or do not fit the network, or ``folder`` holds a run
        of another network.
    FloatingPointError
        If the loss is no longer finite.
    """
    began = saved = time.monotonic()
    pace = pace or Pace()
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    distributed = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if distributed:
        torch.distributed.init_process_group(
            "nccl" if torch.device(device).type == "cuda" else "gloo"
        )
    try:
        trainer = Trainer(config, device=device)
        resumed = trainer.resume(place / "checkpoint")
        log = RunLog(place, steps=config.optimiser.steps, enabled=trainer.leads)
        log.say(
            f"{'resumed at' if resumed else 'new run, from'} step {trainer.step} of"
            f" {config.optimiser.steps}"
        )
        sources = make_sources(config, device=device, workers=workers)

        def due() -> bool:
            return (
                trainer.step % pace.validate_steps == 0 or trainer.step == config.optimiser.steps
            )

        def validate() -> None:
            log.validated(
                trainer.step, validation_mnc(trainer, sources.validation), loss=trainer.loss
            )

        validated = log.resume(trainer.step, between=not due())
        timed = trainer.leads and math.isfinite(pace.minutes)
        validation_s = _validation_time_s(trainer, sources.validation) if timed else 0.0
        end = began + 60 * pace.minutes
        updates_end = end - (validation_s if validation_s <= 0.5 * 60 * pace.minutes else 0.0)
        with _asked_to_stop() as asked:
            while trainer.step < config.optimiser.steps:
                if trainer.leads and trainer.step and due() and not validated:
                    validate()
                started = time.monotonic()
                losses = trainer.update(sources.training)
                validated = False
                now = time.monotonic()
                log.step(
                    trainer.step, losses, batch=config.optimiser.batch, seconds=trainer.seconds
                )
                another = now + (now - started)  # the end of another update
                if due():
                    another += validation_s
                if _agreed(asked() or another > updates_end, device=trainer.device):
                    break
                if now - saved > pace.save_s:
                    trainer.save(place / "checkpoint")
                    saved = time.monotonic()
        trainer.save(place / "checkpoint")
        if trainer.leads and not validated:
            finished = trainer.step == config.optimiser.steps
            if finished or time.monotonic() + validation_s <= end + _SLACK_S:
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
    """Seconds that a validation takes, as a few photos predict; twice, for the first time may load
    code.
    """
    few = batches[0].split(_TRIAL_PHOTOS)[0]
    seconds = []
    for _ in range(2):
        began = time.monotonic()
        validation_scores(trainer, (few,))
        seconds.append(time.monotonic() - began)
    return min(seconds) * sum(map(len, batches)) / len(few)


def validation_mnc(
    trainer: Trainer, batches: tuple[Batch, ...], *, steps: int = _SAMPLING_STEPS
) -> float:
    """Mean of :func:`validation_scores`; for comparing runs, not for reports."""
    return float(validation_scores(trainer, batches, steps=steps).mean())


def validation_scores(
    trainer: Trainer, batches: tuple[Batch, ...], *, steps: int = _SAMPLING_STEPS
) -> NDArray[np.float64]:
    """MNC (whole-pixel shifts) of one sample per photo (N,), drawn with the averaged weights, over
    the batches.

    The truth is the time-weighted HR map's own PSF.
    """
    network = trainer.average
    scores: list[float] = []
    generator = torch.Generator(trainer.device).manual_seed(_VALIDATION_SEED)
    with torch.no_grad():
        for batch in batches:
            drawn = drawn_psfs(
                network, batch, schedule=trainer.schedule, steps=steps, generator=generator
            )
            found = drawn.double().cpu().numpy()
            truth = psfs_of_maps(batch.dwell[:, 0]).double().cpu().numpy()
            scores += [mnc(a, b) for a, b in zip(found, truth, strict=True)]
    return np.array(scores)


def _shards(entry: str, folder: str) -> Samples:
    """Read prepared samples; errors name the entry of the run's file."""
    try:
        return read_shards(folder)
    except ValueError as error:
        raise ValueError(f"data.{entry}: {error}") from None


def _check_channels(config: TrainingConfig, kernels: int) -> None:
    there = 2 + 2 * kernels
    wanted = config.network.physics_channels
    if wanted not in (0, there):
        raise ValueError(
            f"network.physics_channels: must be {there}, as many as there are physics maps, got"
            f" {wanted}"
        )


def _agreed(over: bool, *, device: torch.device) -> bool:
    """Whether any process wants to end: all must do so after the same step, or the others wait for
    it for ever.
    """
    if not torch.distributed.is_initialized():
        return over
    wish = torch.tensor(float(over), device=device)
    torch.distributed.all_reduce(wish, torch.distributed.ReduceOp.MAX)
    return bool(wish)


@contextmanager
def _asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Note SIGINT and SIGTERM instead of dying: the step is finished and the state saved. A second
    one kills.
    """
    seen: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(seen)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
