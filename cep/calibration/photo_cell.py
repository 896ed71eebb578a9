"""The motion of one photo of a folder, as the work of a cell."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from cep.calibration.calibrate import estimate_motion, read_options
from cep.files.images import read_photo
from cep.jobs.cells import Figure
from cep.jobs.fingerprint import source_version
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.registry import METHODS, blind_methods
from motdiff.files.json_files import plain
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory


def estimate_photo(
    *,
    photo: Path,
    method: str,
    gamma: str = "srgb",
    seed: int = 0,
    **options: Any,
) -> dict[str, Figure]:
    """Estimate the motion in a photo on one thread: the work of a cell, see
    :mod:`cep.jobs.engine`.

    Parameters
    ----------
    photo : Path
    method, seed
        As of :func:`cep.calibration.calibrate.estimate_motion`, any method but "gyro".
    gamma : str
        Of the photos, as of :func:`cep.files.images.read_photo`.
    **options
        Of the method, as of :func:`cep.calibration.calibrate.read_options`.

    Returns
    -------
    dict
        ``estimate`` and ``warnings`` of the file, as texts for :func:`estimate_from_figures`, and
        ``seconds``.

    Raises
    ------
    ValueError
        If the photo cannot be read, has no texture, or the estimator refuses it.
    """
    try:
        read = read_photo(photo, gamma=gamma)
        values = read_options(method, options, gamma=gamma)
        began_s = time.perf_counter()
        # as many as there are workers run at once, and sums must not depend on how many do
        with one_thread() if method in blind_methods() else nullcontext():
            found = estimate_motion(read.pixels, method=method, seed=seed, **values)
    except ValueError as error:
        raise ValueError(str(error).removeprefix(f"{photo}: ")) from None
    seconds = time.perf_counter() - began_s
    warnings = [*(line.removeprefix(f"{photo}: ") for line in read.warnings), *found.warnings]
    return {"estimate": _text_of(found), "warnings": json.dumps(warnings), "seconds": seconds}


def estimate_from_figures(figures: Mapping[str, Figure]) -> tuple[MotionEstimate, list[str]]:
    """Return the estimate as it was, to the last bit, and the warnings about it and its photo."""
    stored: dict[str, Any] = json.loads(str(figures["estimate"]))
    paths = tuple(
        Trajectory(path["t"], np.array(path["xy"]), path["direction"])
        for path in stored.pop("trajectories")
    )
    psf = np.frombuffer(base64.b64decode(stored["psf"]["data"]), dtype="<f8").reshape(
        stored["psf"]["shape"]
    )
    warnings = json.loads(str(figures["warnings"]))
    found = MotionEstimate(
        stored["method"],
        paths,
        tuple(stored["weights"]),
        psf,
        stored["confidence"],
        tuple(stored["warnings"]),
        stored["details"],
        tuple(stored["psf_warnings"]),
    )
    return found, warnings


def estimator_version(method: str) -> str:
    """Fingerprint of all that makes an estimate: the code and, where there are, the weights."""
    files = METHODS[method]().weight_files() if method in blind_methods() else ()
    named = f"motdiff.estimators.{method}" if method in METHODS else method.partition(":")[0]
    followed = [named, "motdiff.simulate"]
    decoding = ["cep.files.images", "motdiff.files.decoding"]
    return source_version(
        followed, alone=[__name__, "cep.calibration.calibrate", *decoding], files=files
    )


def _text_of(found: MotionEstimate) -> str:
    """Spell an estimate; floats come back as they were."""
    psf = np.ascontiguousarray(found.psf, dtype="<f8")
    return json.dumps(
        {
            "method": found.method,
            "trajectories": [
                {"t": path.t.tolist(), "xy": path.xy.tolist(), "direction": path.direction}
                for path in found.trajectories
            ],
            "weights": [float(weight) for weight in found.weights],
            "psf": {"shape": psf.shape, "data": base64.b64encode(psf.tobytes()).decode()},
            "confidence": float(found.confidence),
            "warnings": list(found.warnings),
            "psf_warnings": list(found.psf_warnings),
            "details": plain(found.details),
        }
    )
