"""Training of code and network together, in pieces of any length."""

from __future__ import annotations

import csv
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from cep.codes.published import published
from cep.optics.code import ShutterCode
from lab.trainings.dce.model import (
    RestorationNetwork,
    binarise,
    code_of,
    coded_photos,
    restoration_loss,
    weights_of,
)
from lab.trainings.dce.samples import Batch, Samples
from motdiff.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint

START = published("merl-32-t64").code.bits
"""The code that DCE starts from."""

_LEARNED_FROM = 0.25
_LEARNED_TO = 0.75
_LAST_RATE = 0.02  # of the first, at the end of the cosine
_LONGEST_GRADIENT = 1.0
_LOG_STEPS = 10
_SMOOTH = 0.97
_FIELDS = ("step", "seconds", "loss", "open_chips", "flips", "bits")


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes
    ----------
    start : str
        The code it begins with; it has as many chips.
    batch : int
        Samples per update.
    crop_px : int
    rate, code_rate : float
        Adam's first step sizes, for the network and for the chips' weights.
    margin : float
        Distance of the chips' first weights from the threshold.
    seed : int

    Raises
    ------
    ValueError
        If ``start`` is no code.
    """

    start: str = START
    batch: int = 4
    crop_px: int = 128
    rate: float = 6e-4
    code_rate: float = 5e-4
    margin: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        ShutterCode(self.start)


class CodeTrainer:
    """Network, code and their optimisers.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.network = RestorationNetwork()
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.weights = nn.Parameter(
            weights_of(ShutterCode(settings.start), margin=settings.margin)
        )
        self._adam = torch.optim.Adam(self.network.parameters(), lr=settings.rate)
        self._code_adam = torch.optim.Adam([self.weights], lr=settings.code_rate)
        self.step = 0
        self.seconds = 0.0

    def update(self, batch: Batch, *, progress: float) -> float:
        """Make one update at a share ``progress`` of the run, 0..1; returns the loss.

        The code is learned in the middle half of the run. Before, the untrained network gives no
        useful gradient; after, the network is trained for the final code.

        Raises
        ------
        FloatingPointError
            If the loss is not finite.
        """
        cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        for group in self._adam.param_groups:
            group["lr"] = self.settings.rate * (_LAST_RATE + (1 - _LAST_RATE) * cosine)
        learns = _LEARNED_FROM <= progress < _LEARNED_TO
        loss = restoration_loss(
            self.network(photos_of(batch, binarise(self.weights))), batch.sharp
        )
        if not loss.isfinite():
            raise FloatingPointError(
                f"loss: is {float(loss.detach())} at step {self.step}; train with a smaller rate"
            )
        self._adam.zero_grad()
        self._code_adam.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._adam.step()
        if learns:
            self._code_adam.step()
            with torch.no_grad():
                self.weights.clamp_(0, 1)
        self.step += 1
        return float(loss.detach())

    @property
    def code(self) -> ShutterCode:
        """The code as it stands."""
        return code_of(self.weights)

    def save(self, file: Path) -> None:
        """Write everything that :meth:`resume` needs."""
        tensors: dict[str, Tensor] = {"code": self.weights.detach()}
        tensors |= {f"model.{name}": value for name, value in self.network.state_dict().items()}
        for kind, adam in (("adam", self._adam), ("code_adam", self._code_adam)):
            for number, state in adam.state_dict()["state"].items():
                tensors |= {f"{kind}.{number}.{name}": value for name, value in state.items()}
        write_checkpoint(file, Checkpoint(self.step, tensors, asdict(self.settings), self.seconds))

    def resume(self, file: Path) -> None:
        """Go on from a checkpoint, if there is one.

        Raises
        ------
        ValueError
            If it is another run's.
        """
        checkpoint = read_checkpoint(file)
        if checkpoint is None:
            return
        if (settings := asdict(self.settings)) != checkpoint.config:
            name = next(name for name in settings if settings[name] != checkpoint.config.get(name))
            raise ValueError(
                f"{name}: the run in {file} has {checkpoint.config.get(name)!r}, got"
                f" {settings[name]!r}"
            )
        self.network.load_state_dict(checkpoint.under("model."))
        with torch.no_grad():
            self.weights.copy_(checkpoint.tensors["code"])
        for kind, adam in (("adam.", self._adam), ("code_adam.", self._code_adam)):
            state: dict[int, dict[str, Tensor]] = {}
            for name, value in checkpoint.under(kind).items():
                number, entry = name.split(".", 1)
                state.setdefault(int(number), {})[entry] = value
            adam.load_state_dict(
                {"state": state, "param_groups": adam.state_dict()["param_groups"]}
            )
        self.step = checkpoint.step
        self.seconds = checkpoint.seconds


def photos_of(batch: Batch, chips: Tensor) -> Tensor:
    """Noisy coded photos (B, 1, H, W) at the scale of the full open exposure: a dark code's noise
    grows with it.
    """
    return (coded_photos(batch.scenes, batch.chip_psfs, chips) + batch.noise) / chips.mean()


def train(
    trainer: CodeTrainer,
    samples: Samples,
    folder: Path,
    *,
    steps: int,
    minutes: float = math.inf,
    save_s: float = 60.0,
) -> None:
    """Train, or go on training, until ``steps`` updates are done or ``minutes`` are over.

    Parameters
    ----------
    trainer : CodeTrainer
    samples : Samples
    folder : path
        ``checkpoint`` and ``log.csv`` go there.
    steps : int
        Updates of the whole run; they set the pace at which the step size falls and when the code
        is learned.
    minutes : float
        Length of this piece.
    save_s : float
        Seconds between checkpoints.

    Raises
    ------
    ValueError
        If there is no step to do, or the checkpoint in ``folder`` is another run's.
    """
    if steps < 1:
        raise ValueError(f"steps: must be at least 1, got {steps}")
    folder.mkdir(parents=True, exist_ok=True)
    trainer.resume(folder / "checkpoint")
    started = saved = moment = time.monotonic()
    smooth = math.nan
    before = trainer.seconds
    while trainer.step < steps and moment - started < 60 * minutes:
        progress = trainer.step / steps
        loss = trainer.update(
            samples.batch(trainer.step, trainer.settings.batch), progress=progress
        )
        smooth = loss if math.isnan(smooth) else _SMOOTH * smooth + (1 - _SMOOTH) * loss
        moment = time.monotonic()
        trainer.seconds = before + moment - started
        if trainer.step % _LOG_STEPS == 0:
            _log(folder / "log.csv", trainer, smooth)
        if moment - saved >= save_s:
            trainer.save(folder / "checkpoint")
            saved = moment
    trainer.save(folder / "checkpoint")


def _log(path: Path, trainer: CodeTrainer, loss: float) -> None:
    code = trainer.code
    flips = sum(a != b for a, b in zip(code.bits, trainer.settings.start, strict=True))
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(_FIELDS)
        row = (
            trainer.step,
            f"{trainer.seconds:.0f}",
            f"{loss:.5f}",
            code.open_chips,
            flips,
            code.bits,
        )
        writer.writerow(row)
