"""Newton descent of |H| to a local minimum or zero inside a box, compiled."""

from __future__ import annotations

import numpy as np

from cep.compiled import compiled
from cep.proofs.certify.taylor import Pieces
from motdiff.types import FloatArray

_STEPS = 60


def polish(pieces: Pieces, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Descend from (F, 2) frequencies: the local minima (F, 2) of |H| within the box, and |H|
    there (F,).
    """
    points = np.array(starts, dtype=np.float64)
    lowest = np.empty(len(points))
    _descend(points, pieces.box, pieces.weight, pieces.middle, pieces.delta, lowest)
    return points, lowest


@compiled
def _expand(
    fx: float,
    fy: float,
    weight: FloatArray,
    middle: FloatArray,
    delta: FloatArray,
    out: FloatArray,
) -> None:
    """Write H, its gradient and second derivatives xx, xy, yy as real and imaginary parts:
    (12,).
    """
    mx = middle[0]
    my = middle[1]
    dx = delta[0]
    dy = delta[1]
    hr = hi = xr = xi = yr = yi = ar = ai = br = bi = cr = ci = 0.0
    for s in range(weight.size):
        turn = fx * mx[s] + fy * my[s]
        turn -= np.floor(turn + 0.5)
        re = weight[s] * np.cos(2 * np.pi * turn)
        im = -weight[s] * np.sin(2 * np.pi * turn)
        x = np.pi * (fx * dx[s] + fy * dy[s])
        z = x * x
        s0 = 1.0 - z / 6 * (1.0 - z / 20 * (1.0 - z / 42 * (1.0 - z / 72 * (1.0 - z / 110))))
        s1 = -x / 3 * (1.0 - z / 10 * (1.0 - z / 28 * (1.0 - z / 54 * (1.0 - z / 88))))
        s2 = -(1.0 - 3 * z / 10 * (1.0 - 5 * z / 84 * (1.0 - 7 * z / 270))) / 3
        hr += s0 * re
        hi += s0 * im
        # derivatives of sinc(f.d) exp(-2 pi i f.m) in units of (2 pi)^order; 1/2 d is half the
        # piece
        ux = 0.5 * dx[s]
        uy = 0.5 * dy[s]
        xr += mx[s] * s0 * im + ux * s1 * re
        xi += ux * s1 * im - mx[s] * s0 * re
        yr += my[s] * s0 * im + uy * s1 * re
        yi += uy * s1 * im - my[s] * s0 * re
        # (-i m + u d/dx)^2 sinc = -m m s0 - i (m u + u m) s1 + u u s2
        e = ux * ux * s2 - mx[s] * mx[s] * s0
        f = -2 * mx[s] * ux * s1
        ar += e * re - f * im
        ai += e * im + f * re
        e = ux * uy * s2 - mx[s] * my[s] * s0
        f = -(mx[s] * uy + my[s] * ux) * s1
        br += e * re - f * im
        bi += e * im + f * re
        e = uy * uy * s2 - my[s] * my[s] * s0
        f = -2 * my[s] * uy * s1
        cr += e * re - f * im
        ci += e * im + f * re
    slope_scale = 2 * np.pi
    turn2 = 4 * np.pi**2
    out[0], out[1] = hr, hi
    out[2], out[3], out[4], out[5] = (
        slope_scale * xr,
        slope_scale * xi,
        slope_scale * yr,
        slope_scale * yi,
    )
    out[6], out[7], out[8], out[9], out[10], out[11] = (
        turn2 * ar,
        turn2 * ai,
        turn2 * br,
        turn2 * bi,
        turn2 * cr,
        turn2 * ci,
    )


@compiled
def _step(jet: FloatArray, free_x: bool, free_y: bool) -> tuple[float, float]:
    """Newton's step of |H|^2 / 2, or Gauss's where it is not convex."""
    gx = jet[0] * jet[2] + jet[1] * jet[3]
    gy = jet[0] * jet[4] + jet[1] * jet[5]
    a = jet[2] * jet[2] + jet[3] * jet[3]
    b = jet[2] * jet[4] + jet[3] * jet[5]
    c = jet[4] * jet[4] + jet[5] * jet[5]
    na = a + jet[0] * jet[6] + jet[1] * jet[7]
    nb = b + jet[0] * jet[8] + jet[1] * jet[9]
    nc = c + jet[0] * jet[10] + jet[1] * jet[11]
    if free_x and free_y:
        if na + nc > 0.0 and na * nc - nb * nb > 1e-6 * (na + nc) * (na + nc):
            a = na
            b = nb
            c = nc
        else:
            lift = 1e-3 * (a + c)
            a = a + lift
            c = c + lift
        det = a * c - b * b
        if det <= 0.0:
            return 0.0, 0.0
        return -(c * gx - b * gy) / det, -(a * gy - b * gx) / det
    if free_x:
        a = na if na > 1e-3 * a else a
        return (-gx / a if a > 0.0 else 0.0), 0.0
    if free_y:
        c = nc if nc > 1e-3 * c else c
        return 0.0, (-gy / c if c > 0.0 else 0.0)
    return 0.0, 0.0


@compiled
def _descend(
    points: FloatArray,
    box: FloatArray,
    weight: FloatArray,
    middle: FloatArray,
    delta: FloatArray,
    lowest: FloatArray,
) -> None:
    jet = np.empty(12)
    trial = np.empty(12)
    for i in range(points.shape[0]):
        fx = points[i, 0]
        fy = points[i, 1]
        _expand(fx, fy, weight, middle, delta, jet)
        value = np.sqrt(jet[0] * jet[0] + jet[1] * jet[1])
        for _ in range(_STEPS):
            gx = jet[0] * jet[2] + jet[1] * jet[3]
            gy = jet[0] * jet[4] + jet[1] * jet[5]
            # at an edge whose outside is lower, only the other axis is free
            free_x = not ((fx <= box[0, 0] and gx >= 0.0) or (fx >= box[0, 1] and gx <= 0.0))
            free_y = not ((fy <= box[1, 0] and gy >= 0.0) or (fy >= box[1, 1] and gy <= 0.0))
            step_x, step_y = _step(jet, free_x, free_y)
            better = False
            for _ in range(12):
                new_x = min(box[0, 1], max(box[0, 0], fx + step_x))
                new_y = min(box[1, 1], max(box[1, 0], fy + step_y))
                if new_x == fx and new_y == fy:
                    break
                _expand(new_x, new_y, weight, middle, delta, trial)
                modulus = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1])
                if modulus < value:
                    better = modulus < value * (1 - 1e-15)
                    fx = new_x
                    fy = new_y
                    value = modulus
                    jet[:] = trial
                    break
                step_x *= 0.35
                step_y *= 0.35
            if not better:
                break
        points[i, 0], points[i, 1], lowest[i] = fx, fy, value
