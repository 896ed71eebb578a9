"""OTFs of exposures of one motion through known codes, and their derivatives by the path."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.codes import open_at
from motdiff.types import FloatArray

_SMALL = 1e-2  # half phases below this are expanded: sin(h) / h loses digits there


class CodedOtfs:
    """Exact OTFs, 1 at zero frequency, of paths that are straight between evenly spaced knots.

    A straight, uniform piece from a to b that lasts dt has the OTF ``dt exp(-pi i f.(a + b))
    sinc(f.(b - a))``, as in :class:`motdiff.trajectory.Trajectory`; an exposure sums those of its
    open pieces.

    Parameters
    ----------
    codes : sequence of str
        Bits of each exposure's code, played over the whole exposure.
    """

    def __init__(self, codes: Sequence[str], knots: int) -> None:
        times = np.linspace(0, 1, knots)
        edges = [np.linspace(0, 1, len(code) + 1) for code in codes]
        # rounded, so that a knot and a chip's edge at one time make no piece of 1e-17 between them
        cuts = np.unique(np.round(np.concatenate([times, *edges]), 12))
        light = open_at(codes, 0.5 * (cuts[1:] + cuts[:-1])) * np.diff(cuts)
        self.open_share: FloatArray = light.sum(axis=1)
        """(I,) open fraction of each code."""
        # positions at the cuts from those at the knots
        before = np.minimum((cuts * (knots - 1)).astype(np.intp), knots - 2)
        share = cuts * (knots - 1) - before
        mix = np.zeros((cuts.size, knots))
        mix[np.arange(cuts.size), before] = 1 - share
        mix[np.arange(cuts.size), before + 1] += share
        self._aligned = mix.shape[0] == knots  # chips that begin at the knots need no mixing
        self._mix = torch.tensor(mix, dtype=torch.float32)
        self._light = torch.tensor(light / self.open_share[:, None], dtype=torch.float32)

    @property
    def exposures(self) -> int:
        """Number of exposures, I."""
        return len(self._light)

    def centroids(self, paths: Tensor) -> Tensor:
        """Centroids (B, I, 2) of the PSFs of paths (B, K, 2), px."""
        cuts = self._at_cuts(paths)
        return torch.einsum("is,bsd->bid", self._light, 0.5 * (cuts[:, 1:] + cuts[:, :-1]))

    def otfs(self, paths: Tensor, shifts: Tensor, frequencies: Tensor) -> Tensor:
        """OTFs (B, I, F) of paths (B, K, 2) moved by shifts (B, I, 2), px, at (F, 2) cycles/px."""
        mean, sinc, _ = self._pieces(paths, frequencies)
        H = torch.complex(
            torch.einsum("is,bsf->bif", self._light, sinc * torch.cos(mean)),
            -torch.einsum("is,bsf->bif", self._light, sinc * torch.sin(mean)),
        )
        return H * _phases(shifts, frequencies)

    def with_slopes(
        self, paths: Tensor, shifts: Tensor, frequencies: Tensor
    ) -> tuple[Tensor, Tensor]:
        """OTFs, and their derivatives (B, I, F, K) by ``2 pi f.p`` of each knot's position p."""
        mean, sinc, slope = self._pieces(paths, frequencies)
        cos = torch.cos(mean)
        sin = torch.sin(mean)
        phases = _phases(shifts, frequencies)
        H = torch.einsum(
            "is,bsf->bif", self._light.to(torch.complex64), torch.complex(sinc * cos, -sinc * sin)
        )
        # d/dphase at the piece's start and end: -i/2 T -+ slope/2 exp(-i mean), T the piece's OTF
        common = torch.complex(-0.5 * sinc * sin, -0.5 * sinc * cos)
        spread = torch.complex(0.5 * slope * cos, -0.5 * slope * sin)
        pieces = (
            self._light[None, :, None]
            * torch.stack([common - spread, common + spread]).transpose(2, 3)[:, :, None]
        )
        dH = torch.zeros(*pieces.shape[1:-1], pieces.shape[-1] + 1, dtype=torch.complex64)
        dH[..., :-1] += pieces[0]
        dH[..., 1:] += pieces[1]
        if not self._aligned:
            dH = dH @ self._mix.to(torch.complex64)
        return H * phases, dH * phases[..., None]

    def _at_cuts(self, paths: Tensor) -> Tensor:
        return paths if self._aligned else torch.einsum("uk,bkd->bud", self._mix, paths)

    def _pieces(self, paths: Tensor, frequencies: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Mean phase of each piece, its sinc, and the sinc's derivative, each (B, S, F)."""
        phase = 2 * pi * (self._at_cuts(paths) @ frequencies.T)
        mean = 0.5 * (phase[:, 1:] + phase[:, :-1])
        half = 0.5 * (phase[:, 1:] - phase[:, :-1])
        small = half.abs() < _SMALL
        safe = torch.where(small, torch.ones_like(half), half)
        sinc = torch.where(small, 1 - half**2 / 6, torch.sin(safe) / safe)
        slope = torch.where(small, -half / 3, (torch.cos(safe) - torch.sin(safe) / safe) / safe)
        return mean, sinc, slope


def _phases(shifts: Tensor, frequencies: Tensor) -> Tensor:
    phase = 2 * pi * torch.einsum("bid,fd->bif", shifts, frequencies)
    return torch.complex(torch.cos(phase), -torch.sin(phase))
