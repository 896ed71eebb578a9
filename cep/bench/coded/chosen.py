"""Second stage of the coded-exposure table, a pure function: the code that a design chooses."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from cep.bench.coded.designs import Known, designed
from cep.camera import Camera

__all__ = ["choose_code"]


def choose_code(
    known: Known, *, design: str, chips: int, open_range: tuple[int, int], objective: str, camera: Mapping[str, Any],
    steps: int, seed: int,
) -> dict[str, float | str]:  # fmt: skip
    """Choose a code as a design does; returns ``bits`` and ``cpu_s``. See :mod:`cep.bench.coded.designs`."""
    started = time.process_time()
    code = designed(
        design, known, chips=chips, open_range=open_range, objective=objective, camera=Camera.from_dict(camera),
        steps=steps, rng=np.random.default_rng([seed, 2]),
    )  # fmt: skip
    return {"bits": code.bits, "duty": code.duty, "cpu_s": time.process_time() - started}
