"""Diffusion of motion paths, which draws the paths of kernels."""
