"""Each published code against the search at its own length and light: smallest |P| and noise of deconvolution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cep.certify.minimum import min_chip
from cep.code import ShutterCode
from cep.mtf import chip_noise_db
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem

__all__ = ["CodeRow", "code_rows"]

_MIX = (("min-mtf", 0.1), ("noise", 1.0))  # a decibel of noise is harder won than one of the minimum


@dataclass(frozen=True)
class CodeRow:
    """One comparison, straight uniform motion in chip units.

    Attributes
    ----------
    name : str
    published, ours : ShutterCode
        Of the same number of chips, as many of them open.
    minima : (float, float)
        Smallest |P| over the unit circle, chips: theirs, ours.
    noise_db : (float, float)
        ``10 log10 mean 1/|P|^2``, relative to DC: theirs, ours.
    seconds : float
        Of the search.
    """

    name: str
    published: ShutterCode
    ours: ShutterCode
    minima: tuple[float, float]
    noise_db: tuple[float, float]
    seconds: float

    @property
    def better(self) -> bool:
        """Whether ours is better on both figures."""
        return self.minima[1] > self.minima[0] and self.noise_db[1] < self.noise_db[0]


def code_rows(
    codes: Sequence[tuple[str, ShutterCode]],
    *,
    time_s: float,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _fraction, _name: None,
) -> list[CodeRow]:
    """Search against every code for ``time_s``; the published code itself is no starting point.

    Parameters
    ----------
    codes : sequence of (name, ShutterCode)
    time_s : float
        Per code.
    seed : int
    progress : callable, optional
        Called with the fraction done and the name at hand. Ctrl-C within returns the rows so far.
    """
    rows: list[CodeRow] = []
    for index, (name, code) in enumerate(codes):

        def tick(fraction: float, _best: ShutterCode, index: int = index, name: str = name) -> None:
            progress((index + fraction) / len(codes), name)

        problem = SearchProblem(chips=code.chips, open_range=(code.open_chips, code.open_chips), objective=_MIX)
        try:
            progress(index / len(codes), name)
            found = anneal(problem, rng=np.random.default_rng([seed, index]), steps=None, time_s=time_s, progress=tick)
        except KeyboardInterrupt:
            break
        rows.append(
            CodeRow(
                name,
                code,
                found.code,
                (min_chip(code), min_chip(found.code)),
                (_noise_db(code), _noise_db(found.code)),
                found.seconds,
            )
        )
        if found.interrupted:
            break
    return rows


def _noise_db(code: ShutterCode) -> float:
    return chip_noise_db(code) + 20 * float(np.log10(code.open_chips))
