"""What each command does, as functions of Python: calibrate, optimise, compare, and the demo."""
