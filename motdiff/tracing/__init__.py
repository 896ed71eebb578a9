"""From a drawn motion to an ordered, timed one: PSF -> path -> trajectory.

A PSF shows where the camera went, not in which order. :func:`trace_psf` finds the smoothest walk
that covers what is drawn; :func:`fit_dwell` finds the time spent along it;
:func:`simplest_trajectory` prefers a plain arc, and :func:`smooth_path` fits path and time
together. Direction stays unknown: a path and its reverse draw the same. :func:`is_tangled` is true
where the order along it is uncertain.
"""
