"""The standard model of an image with edges at all scales: discs of random grey."""

import numpy as np


def dead_leaves(side, seed):
    """Square scene (side, side), 0.05..0.95."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side]
    image = np.full((side, side), 0.5)
    for _ in range(side * 3):
        radius = 3 / rng.uniform(0.05, 1)
        cx, cy = rng.uniform(0, side, 2)
        image[(x - cx) ** 2 + (y - cy) ** 2 < radius**2] = rng.uniform(0.05, 0.95)
    return image
