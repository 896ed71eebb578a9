"""Checkpoints: the exact state of a run in files of at most 15 MiB, replaced atomically."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from motdiff.files.inputs import read_json

PART_BYTES = 15 * 2**20
_INDEX = "index.json"
_SCHEMA = "motdiff.checkpoint/1"
_HEADER_BYTES = 160  # of a part's header, at most, for each tensor besides its name


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


def write_checkpoint(folder: Path | str, checkpoint: Checkpoint) -> None:
    """Write ``index.json`` and ``part_*.safetensors`` of at most 15 MiB (or one tensor).

    The old checkpoint stays until the new one is complete.
    """
    target = Path(folder)
    new = target.with_name(target.name + ".new")
    old = target.with_name(target.name + ".old")
    # a kill came between the two renames: the old one is the only one
    if not target.exists() and (old / _INDEX).exists():
        os.rename(old, target)
    for leftover in (new, old):
        shutil.rmtree(leftover, ignore_errors=True)
    new.mkdir(parents=True)
    parts: list[dict[str, Tensor]] = [{}]
    room = PART_BYTES
    for name, tensor in checkpoint.tensors.items():
        plain = tensor.detach().cpu().contiguous()
        size = plain.numel() * plain.element_size() + len(name) + _HEADER_BYTES
        if parts[-1] and size > room:
            parts.append({})
            room = PART_BYTES
        parts[-1][name] = plain
        room -= size
    files = [f"part_{i:03d}.safetensors" for i in range(len(parts))]
    for file, tensors in zip(files, parts, strict=True):
        save_file(tensors, new / file)
    index = {
        "schema": _SCHEMA,
        "step": checkpoint.step,
        "seconds": checkpoint.seconds,
        "files": files,
        "config": checkpoint.config,
    }
    (new / _INDEX).write_text(json.dumps(index, indent=1), encoding="utf-8")
    if target.exists():
        os.rename(target, old)
    os.rename(new, target)
    shutil.rmtree(old, ignore_errors=True)


def read_checkpoint(
    folder: Path | str, *, device: str | torch.device = "cpu"
) -> Checkpoint | None:
    """Read a checkpoint; None where there is none, ValueError where it is not complete."""
    target = Path(folder)
    old = target.with_name(target.name + ".old")
    if not target.exists() and (old / _INDEX).exists():
        target = old  # a kill came between the two renames
    if not target.exists():
        return None
    try:
        index = read_json(target / _INDEX)
        if index["schema"] != _SCHEMA:
            raise ValueError(f"its schema is {index['schema']!r}")
        tensors: dict[str, Tensor] = {}
        for file in index["files"]:
            tensors.update(load_file(target / file, device=str(device)))
        return Checkpoint(index["step"], tensors, index["config"], index["seconds"])
    except (
        ValueError,
        KeyError,
        TypeError,
        FileNotFoundError,
        NotADirectoryError,
        SafetensorError,
    ) as error:
        raise ValueError(f"{target}: is no whole {_SCHEMA} checkpoint: {error}") from error
