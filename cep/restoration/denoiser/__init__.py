"""A small denoiser, told the noise level: the prior of the plug-and-play restoration (see README.md)."""
