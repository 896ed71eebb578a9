"""Diffusion of motion paths in coordinates, told of the kernels found in a photo."""
