"""Weights files of runs: those that a run starts from, and its own export."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from safetensors.torch import save

from motdiff.files.outputs import write_bytes
from motdiff.network.condition import ConditionNetwork
from motdiff.training.checkpoint import read_checkpoint
from motdiff.weights import SCHEMA, network_config, read_network_card
from motdiff.weights_io import packed, read_tensors

PHOTO_PARTS = ("photo.", "fusion.")
"""First parts of the names of a photo encoder's parameters, and of the layer that adds its
features to others."""
_OUTPUT_BIAS = "denoiser.output.1.bias"
_PHOTO_FIELDS = ("backbone", "features", "photo_pool", "width")
_PATHS = (  # entries of a run that name files
    ("data", "photos"),
    ("data", "prepared"),
    ("data", "prepared_validation"),
    ("motions", "gyro_trace"),
    ("optimiser", "start"),
)


def export_weights(
    checkpoint: Path | str,
    target: Path | str,
    *,
    offset: float = 0.0,
    card: Mapping[str, object] | None = None,
    validation_mnc: float | None = None,
) -> int:
    """Write the averaged weights of a run, its configuration in the header; returns the bytes.

    ValueError if there is no checkpoint, float16 cannot hold its weights, or they draw no map that
    an offset could change.

    Parameters
    ----------
    offset : float
        Taken from the path's logits. A loss that weighs path pixels more makes the network say too
        often that a pixel is on the path; sampled with such probabilities, uncertain regions are
        filled in.
    card : mapping, optional
        Further entries of the header: figures, data.
    validation_mnc : float, optional
        Of the run's log, for its line of the history.
    """
    trained = read_checkpoint(checkpoint)
    if trained is None:
        raise ValueError(f"{checkpoint}: holds no checkpoint")
    # ema: exponential moving averages of the weights over the steps
    tensors = packed(trained.under("ema."), source=checkpoint)
    if offset:
        if _OUTPUT_BIAS not in tensors:
            raise ValueError(f"offset: must be 0 for weights without a denoiser, got {offset:g}")
        tensors[_OUTPUT_BIAS][0] -= offset
    line = _line(trained.step, trained.seconds, trained.config, validation_mnc)
    header = {
        "schema": SCHEMA,
        "config": json.dumps(_without_folders(trained.config)),
        "step": str(trained.step),
        "seconds": f"{trained.seconds:.0f}",
        "offset": f"{offset:g}",
        "history": json.dumps([*_earlier(trained.config), line]),
        "card": json.dumps(dict(card or {})),
    }
    data = _in_order(save(tensors, header), header)
    write_bytes(Path(target), data)
    return len(data)


def _earlier(config: Mapping[str, Any]) -> list[dict[str, float | None]]:
    """History of the weights that a run started from; empty without such a file."""
    start = str(config.get("optimiser", {}).get("start", ""))
    if not start or not Path(start).is_file():
        return []
    header = read_network_card(start)
    history: list[dict[str, float | None]] = header["run"]["history"]
    return history or [
        _line(header["run"]["steps"], header["run"]["seconds"], header["config"], None)
    ]


def _line(
    steps: int, seconds: float, config: Mapping[str, Any], validation_mnc: float | None
) -> dict[str, float | None]:
    batch = int(config.get("optimiser", {}).get("batch", 1))
    return {
        "samples": steps * batch,
        "hours": round(seconds / 3600, 2),
        "validation_mnc": validation_mnc,
    }


def _without_folders(config: Mapping[str, object]) -> dict[str, object]:
    """Replace paths by file names: folders of the training machine are not published."""
    sections = {
        name: dict(values) if isinstance(values, Mapping) else values
        for name, values in config.items()
    }
    for name, entry in _PATHS:
        section = sections.get(name)
        if isinstance(section, dict) and section.get(entry):
            section[entry] = Path(str(section[entry])).name
    return sections


def load_start(network: ConditionNetwork, path: Path | str) -> None:
    """Copy a weights file into ``network``: all if they are the same, else its condition network.

    A photo encoder or a global view that the file lacks makes no other network: it keeps its
    values, which are silent. ValueError for a file that is not one of ours, or of other sizes.
    """
    ours = network.config
    theirs = replace(network_config(path), dropout=ours.dropout)  # dropout has no weights
    added: tuple[str, ...] = ()
    if theirs.backbone == "none" and network.physics is not None:
        theirs = replace(theirs, **{name: getattr(ours, name) for name in _PHOTO_FIELDS})
        added += PHOTO_PARTS
    if theirs.denoiser_view == 0:
        theirs = replace(theirs, denoiser_view=ours.denoiser_view)
        added += ("denoiser.view.",)
    is_same = theirs == ours
    parts = {
        name: tensor
        for name, tensor in read_tensors(path).items()
        if is_same or _of_condition(name)
    }
    if is_same and _OUTPUT_BIAS in parts:
        # the logits as they were trained
        parts[_OUTPUT_BIAS][0] += read_network_card(path)["run"]["offset"]
    state = network.state_dict()
    expected = {
        name: tensor.shape
        for name, tensor in state.items()
        if (is_same or _of_condition(name)) and not name.startswith(added)
    }
    if {name: tensor.shape for name, tensor in parts.items()} != expected:
        raise ValueError(f"{path}: its condition network has other sizes than the one to start")
    network.load_state_dict(state | parts)


def _of_condition(name: str) -> bool:
    return name.split(".")[0] in ("photo", "physics", "fusion")


def _in_order(data: bytes, header: Mapping[str, str]) -> bytes:
    """Sort the header's entries, which safetensors shuffles: one run gives the same bytes."""
    start = 8 + int.from_bytes(data[:8], "little")
    text = json.dumps(
        json.loads(data[8:start]) | {"__metadata__": header}, separators=(",", ":")
    ).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data[start:]
