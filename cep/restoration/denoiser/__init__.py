"""Denoiser of the plug-and-play restoration, for white Gaussian noise of a known level."""
