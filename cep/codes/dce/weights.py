"""The weights file: network and code together, with its card in the header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save

from cep.codes.dce.binarise import code_of
from cep.codes.dce.card import SCHEMA, read_card
from cep.codes.dce.network import RestorationNetwork
from motdiff.io.outputs import write_bytes
from motdiff.training.checkpoint import read_checkpoint
from motdiff.weights_io import fill, halved

__all__ = ["export_weights", "load_network"]

_MODEL = "model."


def export_weights(checkpoint: Path | str, target: Path | str, *, notes: Mapping[str, object] | None = None) -> int:
    """Write a run's network as float16, and its code, as one .safetensors file; returns its bytes.

    Parameters
    ----------
    checkpoint : folder of a checkpoint
    target : .safetensors file to write
    notes : mapping, optional
        What else the card should say: data, figures.

    Raises
    ------
    ValueError
        If there is no checkpoint, or float16 cannot hold its weights.
    """
    found = read_checkpoint(checkpoint)
    if found is None:
        raise ValueError(f"{checkpoint}: holds no checkpoint")
    state = {name.removeprefix(_MODEL): value for name, value in found.tensors.items() if name.startswith(_MODEL)}
    tensors = halved(state, source=checkpoint)
    card = {
        "bits": code_of(found.tensors["code"]).bits,
        "settings": found.config,
        "steps": found.step,
        "seconds": round(found.seconds),
        "notes": dict(notes or {}),
    }
    # safetensors shuffles a header's entries: one alone gives the same bytes for the same run
    data = save(tensors, {SCHEMA: json.dumps(card)})
    write_bytes(Path(target), data)
    return len(data)


def load_network(path: Path | str) -> RestorationNetwork:
    """Build the network of a weights file, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    read_card(path)
    network = RestorationNetwork()
    fill(network, path)
    return network
