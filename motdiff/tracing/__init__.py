"""From a drawn motion to an ordered, timed one: PSF -> path -> trajectory.

A PSF shows where the camera went, not in which order. :func:`trace_psf` finds the smoothest walk
that covers what is drawn; :func:`fit_dwell` finds the time spent along it;
:func:`simplest_trajectory` prefers a plain arc. Direction stays unknown: a path and its reverse
draw the same. Blind estimates take paths that are drawn in time
(:mod:`motdiff.network.path_drawing`).
"""
