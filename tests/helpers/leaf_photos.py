"""Photos of dead leaves of any shape, blurred by a motion, with noise."""

import numpy as np

from motdiff.simulate import blur_valid


def leaves(height, width, *, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    image = np.full((height, width), 0.5)
    for _ in range(height * width // 60):
        radius = 3 / rng.uniform(0.05, 1)
        cx = rng.uniform(0, width)
        cy = rng.uniform(0, height)
        near = tuple(slice(max(0, int(c - radius)), int(c + radius) + 2) for c in (cy, cx))
        image[near][(x[near] - cx) ** 2 + (y[near] - cy) ** 2 < radius**2] = rng.uniform(
            0.05, 0.95
        )
    return image


def photo_of(motion, height=128, width=128, *, seed=0):
    sharp = leaves(height + 32, width + 32, seed=seed)
    photo = blur_valid(sharp, motion.psf(33))
    return np.clip(photo + np.random.default_rng(seed).normal(0, 0.005, photo.shape), 0, 1)
