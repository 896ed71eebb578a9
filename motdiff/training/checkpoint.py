"""Checkpoints: the exact state of a run in one file, replaced whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from motdiff.weights_io import read_card, write_with_card

_SCHEMA = "motdiff.checkpoint/2"
_MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class Checkpoint:
    """State of a run.

    Attributes
    ----------
    step : int
        Updates done.
    tensors : mapping from name to Tensor
        Weights (``model.``), their average (``ema.``), Adam's moments (``adam.``) and the smoothed
        ``loss``.
    config : mapping
        The run's configuration as plain values.
    seconds : float
        Time spent so far.
    """

    step: int
    tensors: Mapping[str, Tensor]
    config: Mapping[str, object]
    seconds: float = 0.0

    def under(self, prefix: str) -> dict[str, Tensor]:
        """Tensors whose names begin with ``prefix``, by the rest of their names."""
        return {
            name.removeprefix(prefix): tensor
            for name, tensor in self.tensors.items()
            if name.startswith(prefix)
        }

    def restore_adam(self, adam: torch.optim.Optimizer, network: nn.Module) -> None:
        """Give Adam the moments that it had of a network's parameters."""
        for name, parameter in network.named_parameters():
            moments = {
                # copied into the parameter's own memory layout (channels last), as before the stop
                key: torch.empty_like(parameter).copy_(self.tensors[f"adam.{key}.{name}"])
                for key in _MOMENTS
                if f"adam.{key}.{name}" in self.tensors  # not before the first update
            }
            if moments:
                adam.state[parameter] = {"step": torch.tensor(float(self.step)), **moments}


def write_checkpoint(file: Path | str, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the old one stays until the new one is complete."""
    target = Path(file)
    target.parent.mkdir(parents=True, exist_ok=True)
    tensors = {name: t.detach().cpu().contiguous() for name, t in checkpoint.tensors.items()}
    card = {"step": checkpoint.step, "seconds": checkpoint.seconds, "config": checkpoint.config}
    write_with_card(tensors, target, schema=_SCHEMA, card=card)


def read_checkpoint(file: Path | str, *, device: str | torch.device = "cpu") -> Checkpoint | None:
    """Read a checkpoint; None where there is none, ValueError where it is not complete."""
    if not Path(file).exists():
        return None
    try:
        card = read_card(file, _SCHEMA)
        tensors = load_file(file, device=str(device))
        return Checkpoint(card["step"], tensors, card["config"], card["seconds"])
    except (KeyError, TypeError, SafetensorError) as error:
        raise ValueError(f"{file}: is no whole {_SCHEMA} checkpoint: {error}") from error


def adam_moments(adam: torch.optim.Optimizer, network: nn.Module) -> dict[str, Tensor]:
    """Adam's moments of a network's parameters, by their names in a checkpoint."""
    return {
        f"adam.{key}.{name}": adam.state[parameter][key]
        for name, parameter in network.named_parameters()
        if parameter in adam.state
        for key in _MOMENTS
    }
