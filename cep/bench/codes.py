"""Each published code against the search at its own length and light: smallest |P| and noise of deconvolution."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cep.bench.cells import Cell, Figure
from cep.bench.sources import source_version
from cep.certify.minimum import min_chip
from cep.code import ShutterCode
from cep.mtf import chip_noise_db
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem

__all__ = ["CodeRow", "code_cells", "code_row", "code_rows", "measure_code"]

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


def measure_code(*, bits: str, time_s: float, seed: Sequence[int], threads: int | None = 1) -> dict[str, Figure]:
    """Search against a code; the code itself is no starting point.

    Parameters
    ----------
    bits : str
        Of the published code.
    time_s : float
        Of the search.
    seed : sequence of int
    threads : int, optional
        One where other cells run beside; as many as there are cores when None.

    Returns
    -------
    dict with ``bits`` found, ``minimum`` and ``noise_db`` of the published code, ``our_minimum`` and ``our_noise_db``,
    and ``seconds`` of the search

    Raises
    ------
    KeyboardInterrupt
        When stopped: half a search is no comparison.
    """
    code = ShutterCode(bits)
    problem = SearchProblem(chips=code.chips, open_range=(code.open_chips, code.open_chips), objective=_MIX)
    rng = np.random.default_rng(list(seed))
    found = anneal(problem, rng=rng, steps=None, time_s=time_s, threads=threads)
    if found.stopped == "interrupted":
        raise KeyboardInterrupt
    return {
        "bits": found.code.bits,
        "minimum": min_chip(code),
        "noise_db": _noise_db(code),
        "our_minimum": min_chip(found.code),
        "our_noise_db": _noise_db(found.code),
        "seconds": found.seconds,
    }


def code_cells(codes: Sequence[tuple[str, ShutterCode]], *, time_s: float, seed: int) -> list[Cell]:
    """List the cells of the table; what one code gives does not depend on the others.

    Parameters
    ----------
    codes : sequence of (name, ShutterCode)
        Each name once.
    time_s : float
        Of each search.
    seed : int
    """
    version = source_version(["cep.search.annealing.anneal", "cep.certify.minimum"], alone=[__name__])
    return [
        Cell((name,), measure_code, {"bits": code.bits, "time_s": time_s, "seed": _seed(seed, name)}, version=version)
        for name, code in codes
    ]


def code_row(name: str, code: ShutterCode, figures: Mapping[str, Figure]) -> CodeRow:
    """Read the figures of :func:`measure_code`."""
    theirs, ours, their_db, our_db, seconds = (
        float(figures[key] or 0.0) for key in ("minimum", "our_minimum", "noise_db", "our_noise_db", "seconds")
    )
    return CodeRow(name, code, ShutterCode(str(figures["bits"])), (theirs, ours), (their_db, our_db), seconds)


def code_rows(codes: Sequence[tuple[str, ShutterCode]], *, time_s: float, seed: int = 0) -> list[CodeRow]:
    """Search against every code for ``time_s`` on all cores, one after the other; nothing is kept on disk.

    Parameters
    ----------
    codes : sequence of (name, ShutterCode)
    time_s : float
        Per code.
    seed : int

    Returns
    -------
    list of CodeRow; after Ctrl-C those so far
    """
    rows: list[CodeRow] = []
    for name, code in codes:
        try:
            figures = measure_code(bits=code.bits, time_s=time_s, seed=_seed(seed, name), threads=None)
        except KeyboardInterrupt:
            break
        rows.append(code_row(name, code, figures))
    return rows


def _seed(seed: int, name: str) -> tuple[int, ...]:
    return (seed, *name.encode())


def _noise_db(code: ShutterCode) -> float:
    noise_db = chip_noise_db(code) + 20 * math.log10(code.open_chips)
    return float(noise_db)
