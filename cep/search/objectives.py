"""Objectives of a code search, by name: positive figures of a code's OTF, minimised in decibels.

Another objective is a subclass of :class:`Criterion`, and an instance in the list at the end. The
command line, its help, the laboratory and the page of works read this list; so numpy is imported
where something is computed. H is light-true: lost light raises the cost everywhere but in the
flatness.
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
        ``|H|^2``, light-true; of two cameras the mean of both.
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

    A code is judged by :meth:`figure`, which may be any. The search's compiled loops know three
    kinds of sums over frequencies alone (:mod:`cep.search.annealing.terms`), of a term's x, see
    :meth:`terms`: RECIPROCAL, the sum of ``1 / x``; STEEP, of ``1 / x^4``; FLATNESS, the variance
    of ``|H|``. The kind, its terms and :meth:`light` must rank codes as the figure does, or the
    search ends at other codes than the best: a test asks that of every objective in the list. A
    figure that is none of these needs a fourth kind in the loops.

    Attributes
    ----------
    name, unit, help : str
        As command line and tables show it.
    cites : tuple of str
        Keys of ``cep/files/works.bib``.
    needs : tuple of str
        Fields of :class:`cep.search.problem.SearchProblem` that it depends on besides the motion.
    hot_db : float
        Temperature at which an annealing of 52 chips starts: docs/decisions/search.md.
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

        A term's x is ``light scale |P|^2 + offset``, with ``|P|`` in chips. Of the flatness the
        offset is added to ``|P|^2``.
        """

    def light(self, open_chips: FloatArray, _noise: FloatArray) -> FloatArray:
        """Return the factor of ``|P|^2`` by number of open chips, whose noise is given."""
        return open_chips * 0.0 + 1.0


class MinMtf(Criterion):
    """Smallest modulus over the band, ``-20 log10 min |H|``."""

    name = "min-mtf"
    help = "smallest MTF"
    cites: ClassVar[tuple[str, ...]] = ("raskar2006",)
    hot_db = 0.8
    continuum = True
    kind = STEEP

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``1 / min |H|^2``."""
        lowest: FloatArray = spectrum.power.min(axis=1).astype(float)
        return 1 / lowest

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms of ``sum 1 / |H|^8``, whose fourth root is close to ``1 / min |H|^2``.

        The sum is smooth and the loops can stop early within it, as within a mean.
        """
        flat = columns.weight[None] * 0.0  # no weights: the smallest term alone counts
        return flat + columns.chips**-2, flat + LEAST_X


class Flatness(Criterion):
    """Variance of the modulus over the band, ``10 log10 (var |H| / duty^2)``."""

    name = "flatness"
    help = "variance of the MTF"
    cites: ClassVar[tuple[str, ...]] = ("raskar2006", "jeon2017")
    kind = FLATNESS

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``(mean |H|^2 - mean^2 |H|) / duty^2``."""
        import numpy as np

        mean_power = (spectrum.power @ spectrum.weight).astype(float)
        mean = (np.sqrt(spectrum.power) @ spectrum.weight).astype(float)
        # the difference of two means of equal size may round to zero or below
        return np.asarray(np.maximum(mean_power - mean**2, 1e-12) / spectrum.duty**2)

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the weights of both means, without an offset; the loops form the variance."""
        weight = columns.weight[None]
        return weight, weight * 0.0

    def light(self, open_chips: FloatArray, _noise: FloatArray) -> FloatArray:
        """Return ``1 / open_chips^2``."""
        factor = open_chips * 0.0 + 1.0
        factor[1:] = 1.0 / open_chips[1:] ** 2
        return factor


class NoiseGain(Criterion):
    """Noise gain of the inverse filter, ``10 log10 mean 1 / |H|^2``."""

    name = "noise"
    help = "noise gain of the inverse filter"
    cites: ClassVar[tuple[str, ...]] = ("agrawal2009capture",)
    hot_db = 0.3
    averages = True

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``mean 1 / |H|^2``."""
        mean: FloatArray = ((1 / spectrum.power) @ spectrum.weight).astype(float)
        return mean

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms of the mean."""
        scale = 1 / (columns.weight[None] * columns.chips**2)
        return scale, scale * 0.0 + LEAST_X


class WienerError(Criterion):
    """Expected error, ``10 log10 mean 1 / (|H|^2 / N + 1 / S)`` for noise N and scene S.

    The mean square error of the Wiener filter under a camera's noise.

    References
    ----------
    Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary Time Series", 1949; Field,
    "Relations between the statistics of natural images", J. Opt. Soc. Am. A 4, 1987: a power law.
    """

    name = "mse"
    help = "expected error of the restored photo"
    cites: ClassVar[tuple[str, ...]] = ("wiener1949", "field1987")
    needs: ClassVar[tuple[Literal["camera"], ...]] = ("camera",)
    most_moves = 2**22  # four times as many gain the best code less than 0.03 dB
    averages = True

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return the mean over the band and, on straight motion, over the radii across it."""
        signal = spectrum.power / spectrum.noise.astype(spectrum.power.dtype)[:, None]
        priors = spectrum.priors
        shares = spectrum.shares
        errors = sum(shares[:, q] / (signal + priors[:, q]) for q in range(shares.shape[1]))
        figure: FloatArray = (errors @ spectrum.weight).astype(float)
        return figure

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms ``share / (|H|^2 / N + 1 / S)``, Q of them at each frequency."""
        import numpy as np

        share = (columns.shares * columns.weight[:, None]).T
        counts = share > 0
        scale = np.zeros(share.shape)
        offset = np.full(share.shape, NO_TERM)
        scale[counts] = 1 / (share[counts] * columns.chips**2)
        offset[counts] = columns.priors.T[counts] / share[counts]
        return scale, offset

    def light(self, _open_chips: FloatArray, noise: FloatArray) -> FloatArray:
        """Return ``1 / N``."""
        return 1 / noise


OBJECTIVES: dict[str, Criterion] = {
    criterion.name: criterion for criterion in (MinMtf(), Flatness(), NoiseGain(), WienerError())
}
