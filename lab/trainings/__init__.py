"""Trainings outside the installed packages: the learned code DCE, and the denoiser of
plug-and-play restoration.
"""
