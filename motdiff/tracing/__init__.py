"""From a drawn motion to an ordered, timed one: PSF -> path -> trajectory.

A PSF shows where the camera went, not in which order. :func:`trace_psf` finds the smoothest walk
that covers what is drawn; :func:`fit_dwell` finds the time spent along it;
:func:`simplest_trajectory` prefers a plain arc, and :func:`smooth_path` fits path and time
together. Direction stays unknown: a path and its reverse draw the same. :func:`is_tangled` is true
where the order along it is uncertain.
"""

from motdiff.tracing.dwell import fit_dwell
from motdiff.tracing.path import is_tangled, trace_psf, trace_psf_to_trajectory
from motdiff.tracing.quadratic import plain_trajectory, simplest_trajectory
from motdiff.tracing.smooth import SmoothPath, smooth_path

__all__ = [
    "SmoothPath",
    "fit_dwell",
    "is_tangled",
    "plain_trajectory",
    "simplest_trajectory",
    "smooth_path",
    "trace_psf",
    "trace_psf_to_trajectory",
]
