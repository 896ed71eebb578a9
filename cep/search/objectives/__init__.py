"""Objectives of a code search, by name.

Another objective is a subclass of :class:`Criterion` in a file of its own, and an instance in the
list below. The command line, its help, the laboratory and the page of works read this list.
"""

from __future__ import annotations

from cep.search.objectives.criterion import Criterion
from cep.search.objectives.spectrum import Flatness, MinMtf, NoiseGain
from cep.search.objectives.wiener import WienerError

__all__ = ["OBJECTIVES", "Criterion"]

OBJECTIVES: dict[str, Criterion] = {
    criterion.name: criterion for criterion in (MinMtf(), Flatness(), NoiseGain(), WienerError())
}
