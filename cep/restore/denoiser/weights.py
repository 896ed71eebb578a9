"""The denoiser's weights file, float16, and the denoiser itself as a function on arrays."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from cep.restore.denoiser.network import DenoisingNetwork
from motdiff.files import write_bytes_atomically

__all__ = ["SCHEMA", "SHIPPED", "load_denoiser", "read_card", "write_weights"]

FloatArray = NDArray[np.float64]
SCHEMA = "cep.denoiser/1"
SHIPPED = Path(__file__).with_name("denoiser.safetensors")
"""The weights in the package."""


def write_weights(state: Mapping[str, Tensor], target: Path | str, *, about: Mapping[str, Any]) -> int:
    """Write a network's weights as float16, with a JSON card in the header; returns the bytes.

    Raises
    ------
    ValueError
        If float16 cannot hold them.
    """
    tensors = {name: value.half().contiguous() for name, value in state.items()}
    if wrong := next((name for name, value in tensors.items() if not value.isfinite().all()), None):
        raise ValueError(f"{target}: {wrong} holds values that float16 cannot, above 65504")
    data = save(tensors, {SCHEMA: json.dumps(about)})
    write_bytes_atomically(Path(target), data)
    return len(data)


def read_card(path: Path | str = SHIPPED) -> dict[str, Any]:
    """Read the header of a weights file: ``steps``, ``seconds`` and ``settings`` of its training.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    try:
        with safe_open(str(path), framework="pt") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: cannot be read as weights: {error}") from error
    if SCHEMA not in header:
        raise ValueError(f"{path}: is no {SCHEMA} file, its header has {', '.join(sorted(header)) or 'nothing'}")
    card: dict[str, Any] = json.loads(header[SCHEMA])
    return card


def load_denoiser(path: Path | str = SHIPPED) -> Callable[[FloatArray, float], FloatArray]:
    """Return a weights file's denoiser: a function of an (H, W) image in linear light and its noise's sigma.

    Levels above those it was trained for are the same to it as a darker photo, see :class:`DenoisingNetwork`.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    read_card(path)
    with safe_open(str(path), framework="pt") as file:
        state = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118, not a dict
    network = DenoisingNetwork()
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(f"{path}: its tensors do not fit the network") from error
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    network.eval().requires_grad_(False)

    def denoised(image: FloatArray, sigma: float) -> FloatArray:
        with torch.inference_mode():
            found = network(torch.from_numpy(image[None, None]).float(), torch.tensor([float(sigma)]))
        return np.asarray(found[0, 0].numpy(), dtype=np.float64)

    return denoised
