"""How well sets of calibration codes tell the orders of simulated walks.

python -m lab.studies.calibration_set
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.calibration_set import Contrast, contrast_of_walks, ordered_walks
from lab.bench.coded.calibrations import codes_of_set
from lab.studies.inputs import study_parser
from motdiff.types import FloatArray

CHIPS = 52
WALKS = 100
RANDOM_SETS = 5
SETS = (
    "open+half",
    "open+raskar-52",
    "open+random",
    "designed2",
    "open+raskar-52+half",
    "open+gray2",
    "designed3",
    "open+random+random+random",
    "open+gray3",
    "designed4",
)


def codes_of(name: str, rng: np.random.Generator) -> list[ArrayLike]:
    """Codes of a set, of which ``random`` have half of the chips open."""
    parts = name.split("+")
    if "random" not in parts:
        return [np.array(list(bits), dtype=float) for bits in codes_of_set(name, CHIPS)]
    count = parts.count("random")
    return [np.ones(CHIPS), *(rng.random((count, CHIPS)).argsort(axis=1) < CHIPS // 2)]


def contrast_through(walks: Sequence[FloatArray], codes: Sequence[ArrayLike]) -> Contrast:
    """Contrast of the walks' orders in photos through all codes of a set."""
    contrast = contrast_of_walks(walks, codes[0], chips=CHIPS)
    for code in codes[1:]:
        contrast = contrast.after(code)
    return Contrast.of(contrast)


def main() -> None:
    study_parser(__doc__).parse_args()
    walks = ordered_walks(WALKS, rng=np.random.default_rng(1))
    print("| codes | walks told | chi-square, median | worst tenth |\n|---|---:|---:|---:|")
    for name in SETS:
        sets = RANDOM_SETS if "random" in name else 1
        measured = [
            contrast_through(walks, codes_of(name, np.random.default_rng(k))) for k in range(sets)
        ]
        rows = [(c.walks_told / c.walks, c.median, c.worst_tenth) for c in measured]
        share, median, tenth = np.mean(rows, axis=0)
        print(f"| {name} | {share:.2f} | {median:,.0f} | {tenth:,.0f} |", flush=True)


if __name__ == "__main__":
    main()
