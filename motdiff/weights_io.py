"""Weights files: float16 tensors in safetensors, described by a header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from safetensors import SafetensorError, safe_open

from motdiff.files.inputs import JSON_BYTES, one_line, regular_file
from motdiff.files.outputs import write_bytes

if TYPE_CHECKING:
    from torch import Tensor, nn

    _Network = TypeVar("_Network", bound=nn.Module)


def read_header(path: Path | str) -> dict[str, str]:
    """Read the header of a safetensors file, without torch.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        with regular_file(path).open("rb") as stream:
            header_bytes = int.from_bytes(stream.read(8), "little")
        if header_bytes > JSON_BYTES:
            raise SafetensorError(f"its header has more than {JSON_BYTES >> 20} MiB")
        with safe_open(str(path), framework="np") as file:
            return dict(file.metadata() or {})
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: cannot be read as weights: {one_line(error)}") from error


def read_card(path: Path | str, schema: str) -> dict[str, Any]:
    """Read the JSON object that the header of a weights file holds under the name of its schema.

    Raises
    ------
    ValueError
        If the file is of another schema.
    """
    header = read_header(path)
    if schema not in header:
        schemas = one_line(", ".join(sorted(header)) or "nothing")
        raise ValueError(f"{path}: is no {schema} file, its header has {schemas}")
    try:
        card: dict[str, Any] = json.loads(header[schema])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: its header is not whole: {one_line(error)}") from error
    return card


def halved(state: Mapping[str, Tensor], *, source: Path | str) -> dict[str, Tensor]:
    """Turn the floating-point tensors of a network's state into float16, ready to be saved.

    Parameters
    ----------
    source : path
        Name in error messages.

    Raises
    ------
    ValueError
        If float16 cannot hold a value.
    """
    tensors = {
        name: (t.half() if t.is_floating_point() else t).contiguous() for name, t in state.items()
    }
    if wrong := next(
        (name for name, tensor in tensors.items() if not tensor.isfinite().all()), None
    ):
        raise ValueError(f"{source}: {wrong} holds values that float16 cannot, above 65504")
    return tensors


def write_with_card(
    state: Mapping[str, Tensor],
    target: Path | str,
    *,
    schema: str,
    card: Mapping[str, Any],
    source: Path | str,
) -> int:
    """Write a network's state as float16 with a JSON card under its schema; returns the bytes.

    Parameters
    ----------
    target : .safetensors file to write
    source : path
        Name in error messages.

    Raises
    ------
    ValueError
        If float16 cannot hold a value.
    """
    from safetensors.torch import save

    # safetensors shuffles a header's entries: one alone gives the same bytes for the same run
    data = save(halved(state, source=source), {schema: json.dumps(card)})
    write_bytes(Path(target), data)
    return len(data)


def read_tensors(path: Path | str) -> dict[str, Tensor]:
    """Read the tensors of a weights file, those of floating point as float32."""
    with safe_open(str(path), framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, not a dict
    return {name: t.float() if t.is_floating_point() else t for name, t in tensors.items()}


def filled(network: _Network, path: Path | str, *, schema: str) -> _Network:
    """Fill a network on the CPU from a weights file: eval mode, no gradients, channels last.

    Raises
    ------
    ValueError
        If the file is of another schema, or its tensors do not fit.
    """
    import torch

    read_card(path, schema)
    try:
        network.load_state_dict(read_tensors(path), assign=True)
    except RuntimeError as error:
        raise ValueError(f"{path}: its tensors do not fit the network") from error
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network.eval().requires_grad_(False)
