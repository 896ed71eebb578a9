"""Camera motion: trajectories, PSFs, OTFs, simulation, and estimation from blurred photos."""
