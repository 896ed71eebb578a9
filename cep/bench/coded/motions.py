"""Motions of the coded-exposure table, the same for every photo and design."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cep.bench.coded.protocol import CodedProtocol
from motdiff.motions import boracchi_foi, quadratic, random_straight
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

__all__ = ["drawn_motions"]

_MIXED_LENGTHS_PX = (20.0, 60.0)


def drawn_motions(protocol: CodedProtocol) -> tuple[Trajectory, ...]:
    """Draw the protocol's motions; their direction counts as unknown to all but the oracle."""
    rng = np.random.default_rng([protocol.seed, 0])
    if protocol.shakes == "boracchi-foi":
        return tuple(boracchi_foi(rng) for _ in range(protocol.motions))
    low, high = _MIXED_LENGTHS_PX
    draw: tuple[Callable[[], Trajectory], ...] = (
        lambda: boracchi_foi(rng, max_length_px=float(rng.uniform(low, high))),
        lambda: quadratic(rng, min_length_px=low, max_length_px=high),
        lambda: random_straight(rng, min_length_px=low, max_length_px=high),
    )
    return tuple(_fitting(draw[index % len(draw)]) for index in range(protocol.motions))


def _fitting(draw: Callable[[], Trajectory]) -> Trajectory:
    # a motion that speeds up lies off-centre: the longest of them leave the frame
    while (path := draw()).frame_size() > PSF_PX:
        pass
    return path
