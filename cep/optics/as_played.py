"""Code and PSF as a recorded shutter played them: actual chips on the measured clock."""

from __future__ import annotations

import numpy as np

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.response import ShutterResponse
from hw.recordings.playback import Verification
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray


def achieved_code(played: Verification, *, chip_ns: int) -> ShutterCode:
    """Return the played code with its measured chip time, to the nanosecond.

    Parameters
    ----------
    played : Verification
    chip_ns : int
        Commanded chip time, ns.

    Raises
    ------
    ValueError
        If no chip was open.
    """
    return ShutterCode(played.achieved, max(1, round(chip_ns * (1 + played.scale_ppm * 1e-6))))


def achieved_psf(
    trajectory: Trajectory, played: Verification, *, chip_ns: int, size: int = PSF_PX
) -> FloatArray:
    """PSF of the played code, (size, size), light-true: it sums to the open part of the commanded
    exposure.

    A shutter with a slow clock plays the same chips over a longer stretch of the motion. Openings
    that were longer than the fitted clock says count as closing late.

    Parameters
    ----------
    trajectory : Trajectory
        Motion over the commanded exposure.
    played : Verification
    chip_ns : int
        Commanded chip time, ns.
    size : int

    Raises
    ------
    ValueError
        If no chip was open, or the clock was so slow that the motion is not known for as long.
    """
    code = ShutterCode(played.achieved, chip_ns)
    edges = np.linspace(0, 1 + played.scale_ppm * 1e-6, code.chips + 1)
    late_ns = min(max(played.widening_ns, 0.0), 0.9 * chip_ns)
    response = ShutterResponse(chip_ns=chip_ns, on_bias_ns=late_ns) if late_ns else None
    return coded_psf(trajectory, code, size=size, edges=edges, response=response)
