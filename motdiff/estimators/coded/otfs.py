"""OTFs of exposures of one motion through known codes, and their derivatives by the path."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.codes import open_at
from motdiff.types import FloatArray

# Gauss-Legendre nodes of a piece of the path, and the longest piece, of the exposure: at 0.25
# cycles/px a piece of 4 px, twice as fast as a path of 90 px, is off by 0.02 of its light
_NODES = 3
_LONGEST_PIECE = 1 / 52


class CodedOtfs:
    """OTFs, 1 at zero frequency, of paths that are straight between evenly spaced knots.

    An exposure's OTF is the integral of ``exp(-2 pi i f.p(t))`` over its open chips. Between
    knots and edges of chips it is a sum over the nodes of a Gauss-Legendre quadrature, whose
    exponentials are separate in rows and columns of a grid of frequencies: there an OTF is one
    product of matrices.

    Parameters
    ----------
    codes : sequence of str
        Bits of each exposure's code, played over the whole exposure.
    """

    def __init__(self, codes: Sequence[str], knots: int) -> None:
        edges = [np.linspace(0, 1, len(code) + 1) for code in codes]
        even = np.linspace(0, 1, round(1 / _LONGEST_PIECE) + 1)
        # rounded, so that a knot and a chip's edge at one time make no piece of 1e-17 between them
        cuts = np.unique(np.round(np.concatenate([np.linspace(0, 1, knots), even, *edges]), 12))
        u, share = np.polynomial.legendre.leggauss(_NODES)
        times = (cuts[:-1, None] + 0.5 * np.diff(cuts)[:, None] * (1 + u)).ravel()
        light = open_at(codes, times) * (0.5 * np.diff(cuts)[:, None] * share).ravel()
        self.open_share: FloatArray = light.sum(axis=1)
        """(I,) open fraction of each code."""
        # positions of the nodes from those of the knots
        before = np.minimum((times * (knots - 1)).astype(np.intp), knots - 2)
        fraction = times * (knots - 1) - before
        mix = np.zeros((times.size, knots))
        mix[np.arange(times.size), before] = 1 - fraction
        mix[np.arange(times.size), before + 1] = fraction
        self._mix = torch.tensor(mix, dtype=torch.float32)
        self._light = torch.tensor(light / self.open_share[:, None], dtype=torch.float32)

    @property
    def exposures(self) -> int:
        """Number of exposures, I."""
        return len(self._light)

    def centroids(self, paths: Tensor) -> Tensor:
        """Centroids (B, I, 2) of the PSFs of paths (B, K, 2), px."""
        return self._light @ (self._mix @ paths)

    def otfs(self, paths: Tensor, shifts: Tensor, frequencies: Tensor) -> Tensor:
        """OTFs (B, I, F) of paths (B, K, 2) moved by shifts (B, I, 2), px, at (F, 2) cycles/px."""
        cos, sin = self._node_waves(paths, frequencies)
        return torch.complex(self._light @ cos, -(self._light @ sin)) * _waves(
            shifts @ frequencies.T
        )

    def with_slopes(
        self, paths: Tensor, shifts: Tensor, frequencies: Tensor
    ) -> tuple[Tensor, Tensor]:
        """OTFs, and their derivatives (B, I, K, F) by ``2 pi f.p`` of each knot's position p."""
        cos, sin = self._node_waves(paths, frequencies)
        by_knot = (self._light[:, None] * self._mix.T).flatten(0, 1)  # (I K, N)
        shape = (len(paths), self.exposures, self._mix.shape[1], len(frequencies))
        # the derivative of exp(-i phase) is -i exp(-i phase); the knots' shares of a node sum to 1
        dH = torch.complex(-(by_knot @ sin), -(by_knot @ cos)).reshape(shape)
        waves = _waves(shifts @ frequencies.T)
        return 1j * dH.sum(2) * waves, dH * waves[:, :, None]

    def on_grid(self, paths: Tensor, shifts: Tensor, fy: Tensor, fx: Tensor) -> GridOtfs:
        """OTFs on a grid of frequencies, fy (R,) and fx (C,) cycles/px, and what slopes need."""
        nodes = self._mix @ paths
        rows = _waves(fy[:, None] * nodes[:, None, :, 1])
        columns = _waves(fx[:, None] * nodes[:, None, :, 0])
        down = _waves(shifts[..., 1:] * fy)
        right = _waves(shifts[..., :1] * fx)
        lit_rows = down[..., None] * rows[:, None] * self._light[:, None]
        H = lit_rows.flatten(1, 2) @ columns.transpose(1, 2)
        return GridOtfs(
            H.reshape(*lit_rows.shape[:3], len(fx)) * right[:, :, None],
            nodes=(lit_rows, columns, right),
            frequencies=(fy, fx),
            mix=self._mix,
        )

    def _node_waves(self, paths: Tensor, frequencies: Tensor) -> tuple[Tensor, Tensor]:
        """Cosine and sine (B, N, F) of ``2 pi f.p`` of the nodes p."""
        phase = 2 * pi * (self._mix @ paths @ frequencies.T)
        return torch.cos(phase), torch.sin(phase)


class GridOtfs:
    """OTFs ``H`` (B, I, R, C) on a grid of frequencies; :meth:`CodedOtfs.on_grid` makes them."""

    def __init__(
        self,
        H: Tensor,
        *,
        nodes: tuple[Tensor, Tensor, Tensor],
        frequencies: tuple[Tensor, Tensor],
        mix: Tensor,
    ) -> None:
        self.H = H
        self._rows, self._columns, self._right = nodes
        self._fy, self._fx = frequencies
        self._mix = mix

    def slopes(self, by_otf: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes in the knots (B, K, 2) and shifts (B, I, 2) of a function of the OTFs.

        Parameters
        ----------
        by_otf : (B, I, R, C) complex
            Its slope in the real part plus i times that in the imaginary part.
        """
        pulled = by_otf.conj()
        # exp(-2 pi i f p) has the derivative -2 pi i f exp(-2 pi i f p)
        by_shift = 2 * pi * (pulled * self.H).imag
        shifts = torch.stack([by_shift.sum(2) @ self._fx, by_shift.sum(3) @ self._fy], -1)
        pulled = (pulled * self._right[:, :, None]).flatten(1, 2)
        rows = self._rows.flatten(1, 2)
        fy = self._fy.repeat(by_otf.shape[1])
        x = ((pulled @ (self._fx[:, None] * self._columns)) * rows).sum(1).imag
        y = ((pulled @ self._columns) * rows).imag.transpose(1, 2) @ fy
        return 2 * pi * (self._mix.T @ torch.stack([x, y], -1)), shifts


def _waves(cycles: Tensor) -> Tensor:
    """``exp(-2 pi i cycles)``."""
    phase = 2 * pi * cycles
    return torch.complex(torch.cos(phase), -torch.sin(phase))
