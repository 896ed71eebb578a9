"""Logs of exhaustive proofs: discarded codes per length, and the minimum of the best code."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import Minimum


@dataclass(frozen=True)
class LengthLog:
    """Counts for the codes of one length (all codes, along a trajectory).

    Attributes
    ----------
    length : int
        Chips between the first and the last open one.
    codes : int
        Codes of that length, each way round counted.
    judged : int
        Codes within the limit on light that the scan took up: mirror images mostly once, and none
        that break a run limit in their first, last or middle chips.
    left_by_tables, kept_runs, left_by_samples : int
        Of these, how many the bit tables left, kept every run limit, and were not below the limit
        at any sample. The last are judged one by one.
    complete : bool
    """

    length: int
    codes: int
    judged: int = 0
    left_by_tables: int = 0
    kept_runs: int = 0
    left_by_samples: int = 0
    complete: bool = False

    def grown(self, counts: NDArray[np.int64]) -> LengthLog:
        """Log after another range of heads."""
        scanned, by_tables, within_runs, by_samples = (int(count) for count in counts)
        return replace(
            self,
            judged=self.judged + scanned,
            left_by_tables=self.left_by_tables + by_tables,
            kept_runs=self.kept_runs + within_runs,
            left_by_samples=self.left_by_samples + by_samples,
        )


@dataclass(frozen=True)
class ProofLog:
    """Log of a proof, sufficient to repeat it.

    Attributes
    ----------
    chips : int
    limits : dict
        Limits on light and runs.
    domain : str
        Frequencies of the minimum.
    lengths : tuple of LengthLog
    margin : float
        Relative rounding allowance: codes are discarded below (1 - margin) times the best code's
        certified minimum.
    bits : str
        Best code.
    lower, upper : float
        The largest minimum lies between them; ``upper`` is Parseval's bound until the proof is
        complete.
    versions : dict
    """

    chips: int
    limits: dict[str, int | str | None]
    domain: str
    lengths: tuple[LengthLog, ...]
    margin: float
    bits: str
    lower: float
    upper: float
    versions: dict[str, str]

    @property
    def complete(self) -> bool:
        """Whether every code was accounted for."""
        return all(entry.complete for entry in self.lengths)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class BundledLog:
    """What a proof covers that was made before and comes with the package.

    Attributes
    ----------
    chips : int
        Most chips of the codes that it covers.
    limits : dict
    domain : str
    file : str
        The proof, or the page with its table, in the documentation.
    bits : str
        Best code.
    lower, upper : float
        The largest minimum lies between them.
    judged : int
        Codes judged in this run.
    """

    chips: int
    limits: dict[str, int | str | None]
    domain: str
    file: str
    bits: str
    lower: float
    upper: float
    judged: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class ExactResult:
    """The best code of all, or the best so far.

    Attributes
    ----------
    code : ShutterCode
    minimum : Minimum
        Of |P| on the unit circle in chips, or of |H| over the band along the worst of the
        problem's trajectories.
    proof : ProofLog or BundledLog
    seconds : float
    proven : bool
        Whether no code is better; False when interrupted.
    """

    code: ShutterCode
    minimum: Minimum
    proof: ProofLog | BundledLog
    seconds: float
    proven: bool
