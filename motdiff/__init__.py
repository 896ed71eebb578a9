"""Motion of the camera: trajectories, their PSFs and OTFs, simulation, and estimation from blurred
photographs.
"""
