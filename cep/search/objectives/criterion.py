"""Criterion of a code search: a positive figure of a code's OTF, minimised in decibels.

This module and its siblings import numpy where they compute: the help pages read them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from motdiff.types import FloatArray

RECIPROCAL = 0  # kinds of sums in the compiled loops: 1 / x, 1 / x^4, variance of |H|
STEEP = 1
FLATNESS = 2

LEAST_X = 1e-9  # of a term's x, however deep a zero: 1 / x^4 must not overflow float32
NO_TERM = 1e30  # offset of a term that must vanish: 1 / x is then 0 beside all others


class Spectrum(NamedTuple):
    """OTFs of R codes at the F samples of one scenario in one direction.

    Attributes
    ----------
    power : (R, F)
        ``|H|^2``, light-true.
    weight : (F,)
        Shares of the band, which sum to 1.
    priors, shares : (F, Q)
        Inverse power spectrum of the scene at each sample's radii, and the shares of these.
    duty, noise : (R,)
        Open fraction of the exposure, and variance of the noise.
    """

    power: NDArray[Any]
    weight: NDArray[Any]
    priors: NDArray[Any]
    shares: NDArray[Any]
    duty: FloatArray
    noise: FloatArray


class Columns(NamedTuple):
    """The F samples for the compiled loops, whose OTFs are in chips; as of :class:`Spectrum`."""

    weight: FloatArray
    priors: NDArray[Any]
    shares: NDArray[Any]
    chips: int


class Criterion(ABC):
    """An objective: ``10 log10`` of :meth:`figure` is minimised.

    Attributes
    ----------
    name, unit, help : str
        As command line and tables show it.
    cites : tuple of str
        Keys of ``cep/files/works.bib``.
    needs : tuple of str
        Fields of :class:`cep.search.problem.SearchProblem` that it depends on besides the motion.
    hot_db : float
        Temperature at which an annealing of 26 chips starts: docs/decisions/search.md.
    most_moves : int
        Moves of an annealing beyond which the best code hardly improves.
    averages : bool
        Whether its mean over a class of motions says something. A minimum's does not: along most
        curved paths it is a true zero.
    continuum : bool
        Whether it is a minimum over frequencies, to be taken between the samples as well.
    kind : int
        Sum of the compiled loops: RECIPROCAL, STEEP or FLATNESS.
    """

    name: ClassVar[str]
    unit: ClassVar[str] = "dB"
    help: ClassVar[str]
    cites: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[Literal["camera"], ...]] = ()
    hot_db: ClassVar[float] = 0.1
    most_moves: ClassVar[int] = 2**25
    averages: ClassVar[bool] = False
    continuum: ClassVar[bool] = False
    kind: ClassVar[int] = RECIPROCAL

    @abstractmethod
    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return the figure (R,) of the codes, above 0."""

    @abstractmethod
    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return scale and offset (Q, F) of the terms that the compiled loops sum.

        A term's x is ``light scale |P|^2 + offset``, with ``|P|`` in chips.
        """

    def light(self, open_chips: FloatArray, _noise: FloatArray) -> FloatArray:
        """Return the factor of ``|P|^2`` by number of open chips, whose noise is given."""
        return open_chips * 0.0 + 1.0
