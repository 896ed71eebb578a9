"""Weights files: tensors of 8 bits and float16 in safetensors, described by a header."""

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

_STEP = ".step"
_SMALLEST_WEIGHT = 1e-30  # a filter may be all zeros


def read_header(path: Path | str) -> dict[str, str]:
    """Read the header of a safetensors file, without torch.

    ValueError if it cannot be read.
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

    ValueError if the file is of another schema.
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

    ValueError, which names the ``source``, if float16 cannot hold a value.
    """
    tensors = {
        name: (t.half() if t.is_floating_point() else t).contiguous() for name, t in state.items()
    }
    if wrong := next(
        (name for name, tensor in tensors.items() if not tensor.isfinite().all()), None
    ):
        raise ValueError(f"{source}: {wrong} holds values that float16 cannot, above 65504")
    return tensors


def packed(state: Mapping[str, Tensor], *, source: Path | str) -> dict[str, Tensor]:
    """Pack a network's state in half the bytes of :func:`halved`: matrices and filters in 8 bits.

    The weights of each output are whole multiples, -127 to 127, of a step of its own, which is
    stored under the tensor's name and ".step". Biases and norms stay float16. ValueError as of
    :func:`halved`.
    """
    tensors = halved(state, source=source)
    for name, tensor in state.items():
        # of biases and norms there are few, and no sum averages their errors out
        if tensor.is_floating_point() and tensor.ndim > 1:
            largest = tensor.float().abs().amax(dim=tuple(range(1, tensor.ndim)), keepdim=True)
            step = largest.clamp(min=_SMALLEST_WEIGHT) / 127
            tensors[name] = (tensor / step).round().char().contiguous()
            tensors[name + _STEP] = step
    return tensors


def write_with_card(
    tensors: Mapping[str, Tensor], target: Path | str, *, schema: str, card: Mapping[str, Any]
) -> int:
    """Write tensors, halved or packed, with a JSON card under their schema; returns the bytes."""
    from safetensors.torch import save

    # safetensors shuffles a header's entries: one alone gives the same bytes for the same run
    data = save(dict(tensors), {schema: json.dumps(card)})
    write_bytes(Path(target), data)
    return len(data)


def read_tensors(path: Path | str) -> dict[str, Tensor]:
    """Read the tensors of a weights file, packed or not, those of floating point as float32.

    ValueError if a packed tensor's steps are not one for each output.
    """
    with safe_open(str(path), framework="pt") as file:
        stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, not a dict
    names = [name for name in stored if not name.endswith(_STEP) and name + _STEP in stored]
    steps = {name: stored.pop(name + _STEP) for name in names}
    tensors = {name: t.float() if t.is_floating_point() else t for name, t in stored.items()}
    for name, step in steps.items():
        shape = tensors[name].shape
        # other shapes broadcast: a small file could ask for any amount of memory
        if step.shape != (*shape[:1], *(1 for _ in shape[1:])):
            raise ValueError(
                f"{path}: its tensors do not fit: {one_line(name)} needs a step for each output"
            )
        tensors[name] = tensors[name] * step
    return tensors


def filled(network: _Network, path: Path | str, *, schema: str | None = None) -> _Network:
    """Fill a network on the CPU from a weights file: eval mode, no gradients, channels last.

    ValueError if the file is of another schema than asked for, see :func:`read_card`, or its
    tensors do not fit.
    """
    import torch

    if schema is not None:
        read_card(path, schema)
    try:
        # the tensors become the network's own: nothing is copied
        network.load_state_dict(read_tensors(path), assign=True)
    except RuntimeError as error:
        raise ValueError(f"{path}: its tensors do not fit the network") from error
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network.eval().requires_grad_(False)
