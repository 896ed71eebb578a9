"""Trained weights of the rivals: files of :mod:`motdiff.weights`' format."""

from __future__ import annotations

from pathlib import Path

__all__ = ["PATH_WEIGHTS", "PSF_WEIGHTS"]

PATH_WEIGHTS = Path(__file__).with_name("parametric.safetensors")
PSF_WEIGHTS = Path(__file__).with_name("psf_diffusion.safetensors")
