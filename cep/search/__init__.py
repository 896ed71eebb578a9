"""Search for shutter codes: problem, objectives, annealing, bounds."""
