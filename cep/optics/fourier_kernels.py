"""Compiled Fourier sums of many short straight pieces of a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from motdiff.types import FloatArray

_SAME_PX = 1e-13  # difference of pieces that count as equal: rounding of paths of some 100 px


def chip_sums(
    a: FloatArray,
    b: FloatArray,
    weights: FloatArray,
    chip: NDArray[np.intp],
    chips: int,
    f: FloatArray,
) -> NDArray[np.complex128]:
    """Sum the weighted transforms ``exp(-i pi f.(a + b)) sinc(f.(b - a))`` chip by chip.

    Pieces (S, 2), px, start where the last one ended; ``chip`` (S,) is ascending, below ``chips``.
    With weights (W, S) and frequencies (2, F), cycles/px, the sums are (W, chips, F).
    """
    delta = b - a
    same_step = np.zeros(len(a), dtype=np.bool_)
    # a chain of rotations ends with its chip: it would gather rounding errors
    same_step[1:] = (np.abs(np.diff(delta, axis=0)) < _SAME_PX).all(axis=1) & (np.diff(chip) == 0)
    out = np.zeros((f.shape[1], chips, len(weights)), dtype=np.complex128)
    _accumulate(
        np.pi * f.T.copy(), a + b, delta, same_step, np.ascontiguousarray(weights.T), chip, out
    )
    return out.transpose(2, 1, 0)


@compiled
def _accumulate(
    f: FloatArray,
    end_sums: FloatArray,
    delta: FloatArray,
    same_step: NDArray[np.bool_],
    weights: FloatArray,
    chip: NDArray[np.intp],
    out: NDArray[np.complex128],
) -> None:
    for i in range(f.shape[0]):
        x = f[i, 0]
        y = f[i, 1]
        wave = complex(1.0, 0.0)
        turn = complex(1.0, 0.0)
        gain = 1.0
        for s in range(end_sums.shape[0]):
            if same_step[s]:
                wave *= turn
            else:
                half = x * delta[s, 0] + y * delta[s, 1]
                phase = x * end_sums[s, 0] + y * end_sums[s, 1]
                sine = np.sin(half)
                cosine = np.cos(half)
                gain = sine / half if abs(half) > 1e-9 else 1.0
                # the next middle lies a whole piece ahead: twice the half angle
                turn = complex(cosine * cosine - sine * sine, -2.0 * sine * cosine)
                wave = complex(np.cos(phase), -np.sin(phase))
            term = wave * gain
            for w in range(weights.shape[1]):
                out[i, chip[s], w] += weights[s, w] * term
