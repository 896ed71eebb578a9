"""Denoiser of the plug-and-play restoration; white Gaussian noise of a known level (see
README.md).
"""
