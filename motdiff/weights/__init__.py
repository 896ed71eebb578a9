"""Trained weights: a safetensors file with the configuration of its network in the header."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from motdiff.files.inputs import one_line
from motdiff.network.config import NetworkConfig
from motdiff.network.correction import CorrectionNetwork
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.path_denoiser import PathDenoiser
from motdiff.weights_io import filled, read_header

__all__ = [
    "CORRECTION_SCHEMA",
    "CORRECTION_WEIGHTS",
    "DEFAULT_WEIGHTS",
    "PATH_SCHEMA",
    "PATH_WEIGHTS",
    "SCHEMA",
    "load_correction",
    "load_network",
    "load_path_denoiser",
    "network_config",
    "read_network_card",
]

DEFAULT_WEIGHTS = Path(__file__).with_name("motdiff.safetensors")
CORRECTION_WEIGHTS = Path(__file__).with_name("correction.safetensors")
CORRECTION_SCHEMA = "motdiff.correction/1"
PATH_WEIGHTS = Path(__file__).with_name("paths.safetensors")
PATH_SCHEMA = "motdiff.paths/1"
SCHEMA = "motdiff.weights/1"


def load_network(path: Path | str = DEFAULT_WEIGHTS, *, target: str = "map") -> MotDiffNetwork:
    """Build the diffusion network that a weights file belongs to, in eval mode and float32.

    Parameters
    ----------
    path : weights file
    target : {"map", "psf"}
        Expected target.

    Raises
    ------
    ValueError
        If the file is not one of ours, or draws something else.
    """
    return filled(MotDiffNetwork(network_config(path, target=target)), path)


def load_correction(path: Path | str = CORRECTION_WEIGHTS) -> CorrectionNetwork:
    """Build the network that corrects searched kernels, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return filled(CorrectionNetwork(), path, schema=CORRECTION_SCHEMA)


def load_path_denoiser(path: Path | str = PATH_WEIGHTS) -> PathDenoiser:
    """Build the denoiser of motion paths, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return filled(PathDenoiser(), path, schema=PATH_SCHEMA)


def network_config(path: Path | str, *, target: str | None = None) -> NetworkConfig:
    """Read the configuration of a weights file's network.

    Parameters
    ----------
    target : str, optional
        Expected target; any when omitted.

    Raises
    ------
    ValueError
        If the file is not one of ours, or of another target.
    """
    header = read_network_card(path)
    try:
        config = NetworkConfig.from_dict(header["config"]["network"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path}: its header describes no network known here: {one_line(error)}"
        ) from error
    if target is not None and config.target != target:
        raise ValueError(f"{path}: holds a network of target {config.target!r}, wanted {target!r}")
    return config


def read_network_card(path: Path | str) -> dict[str, dict[str, Any]]:
    """Read a weights file's header: ``config``, ``card``, ``run`` (steps, time, offset, history).

    The history has a line for each run that led to the weights, from the first: ``samples``,
    ``hours`` and ``validation_mnc``. It is empty in files of before.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    header = read_header(path)
    if header.get("schema") != SCHEMA:
        raise ValueError(
            f"{path}: is no {SCHEMA} file, its schema is {one_line(repr(header.get('schema')))}"
        )
    try:
        run: dict[str, Any] = {
            "steps": int(header["step"]),
            "seconds": float(header["seconds"]),
            "offset": float(header["offset"]),
            "history": json.loads(header.get("history", "[]")),
        }
        return {
            "config": json.loads(header["config"]),
            "card": json.loads(header["card"]),
            "run": run,
        }
    except (KeyError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: its header is not whole: {one_line(error)}") from error
