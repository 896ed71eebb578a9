"""Which published works are behind a method, a code, a restoration or a figure, by the names that
commands use.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType

from works import Work, works

from cep.codes.published import names as code_names
from cep.codes.published import published
from cep.restoration.registry import METHODS as RESTORATIONS
from cep.search.objectives import OBJECTIVES
from lab.evaluation.methods import RIVALS
from motdiff.estimators.registry import METHODS as ESTIMATORS

SOFTWARE = "coded-exposure"
"""Name and key of this software itself."""

_JOINT_FIT = ESTIMATORS["coded"].cites
_WIENER = ("wiener1949", "field1987")

_NAMES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "estimators of motion": {
        **{name: method.cites for name, method in ESTIMATORS.items()},
        **{name: rival.cites for name, rival in RIVALS.items()},
    },
    "ways to choose a code": {
        "open": (),
        "snapshot": ("agrawal2009capture", "tendero2013"),
        "strobe": (),
        "random": (),
        "dnf": ("agrawal2009capture",),
        "dce": ("zhang2023dce",),
        "class-snapshot": (),
        "class": (),
        "parametric-oracle": ("zhang2022etr",),
        "one-way": ("choi2025motdiff",),
        "posterior": (),
        "both-ways": (),
        "calibrated-2": _JOINT_FIT,
        "calibrated-4": _JOINT_FIT,
        "calibrated-point": ("howie2017",),
        "oracle": (),
    },
    "objectives": {name: criterion.cites for name, criterion in OBJECTIVES.items()},
    "search and proofs": {
        "anneal": ("kirkpatrick1983",),
        "exact": ("hare2021",),
        "pareto": ("paquete2004",),
        "frames": ("agrawal2009video",),
        "bound": ("lovasz1991", "goemans1995", "benson2000", "mo2018"),
        "certificate": ("kantorovich1982", "ortega1968"),
    },
    "advice and cameras": {
        "advise": ("tendero2013", "cossairt2013", "agrawal2009capture"),
        "camera": ("emva1288", "janesick2007"),
    },
    "restorations": {
        **{name: method.cites for name, method in RESTORATIONS.items()},
        "borders": ("liu2008",),
        "clipping": ("almeida2013", "whyte2014"),
    },
    "figures": {
        "mnc": ("hu2012",),
        "mnc_subpixel": ("hu2012", "levin2009"),
        "path_mnc": ("hu2012",),
        "psnr_db": (),
        "ssim": ("wang2004",),
        "intervals": ("cameron2011",),
    },
    "motions and photos": {
        "walk": ("boracchi2012", "kupyn2018"),
        "levin": ("levin2009",),
        "koehler": ("koehler2012",),
        "gopro": ("nah2017",),
        "rsblur": ("rim2022",),
    },
}


@dataclass(frozen=True)
class Citations:
    """Works behind names.

    Attributes
    ----------
    works : mapping from the key of a work to tuple of str
        Each with the names that it is behind; this software itself where a name has no work.
    unpublished : tuple of str
        Names behind which is no work but this software.
    """

    works: Mapping[str, tuple[str, ...]]
    unpublished: tuple[str, ...]

    @property
    def bibtex(self) -> str:
        """A BibTeX file, each entry below a comment with its names."""
        blocks = []
        for key, named in self.works.items():
            entry = software() if key == SOFTWARE else works()[key]
            behind = ", ".join(_families(name for name in named if name != key))
            blocks.append(f"% {behind}\n{entry.bibtex}" if behind else entry.bibtex)
        return "\n\n".join(blocks) + "\n"


@cache
def citable() -> Mapping[str, Mapping[str, tuple[str, ...]]]:
    """Return the keys of the works behind each name, by kinds of names."""
    codes = {name: published(name).works for name in code_names()}
    return MappingProxyType({"published codes": codes, **_NAMES})


def software() -> Work:
    """Return this software as a work, of the version that runs."""
    from cep import __version__

    fields = {
        "author": "{The authors of coded-exposure}",
        "title": "coded-exposure: the shutter code for a camera's motion",
        "note": f"Version {__version__}",
    }
    body = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
    return Work(SOFTWARE, "misc", fields, f"@misc{{{SOFTWARE},\n{body}\n}}")


def cite(methods: Iterable[str] = ()) -> Citations:
    """Find the works behind names.

    Parameters
    ----------
    methods : iterable of str
        Names as commands use them, of any kind, or keys of works; all works when there is none.

    Raises
    ------
    ValueError
        If a name is not known; the line has those that are near.

    Examples
    --------
    >>> list(cite(["dnf", "raskar-52"]).works)
    ['agrawal2009capture', 'raskar2006']
    """
    known: dict[str, tuple[str, ...]] = {}
    for named in citable().values():
        for name, keys in named.items():
            known[name] = tuple(dict.fromkeys((*known.get(name, ()), *keys)))
    asked = list(dict.fromkeys(methods))
    found: dict[str, list[str]] = {}
    unpublished = []
    for given in asked or [SOFTWARE, *(name for name, keys in known.items() if keys), *works()]:
        name = re.split("[:@]", given)[0]  # of selfdeblur:5000 or network@FILE
        if name in works() or name == SOFTWARE:
            found.setdefault(name, []).append(name)
        elif name not in known:
            raise ValueError(f"methods: {_unknown(given, [*known, *works(), SOFTWARE])}")
        elif not known[name]:
            unpublished.append(name)
            found.setdefault(SOFTWARE, []).append(name)
        for key in known.get(name, ()):
            found.setdefault(key, []).append(name)
    return Citations(
        {key: tuple(dict.fromkeys(named)) for key, named in found.items()}, tuple(unpublished)
    )


def _unknown(name: str, known: list[str]) -> str:
    near = get_close_matches(name.lower(), known, n=3, cutoff=0.5)
    right = (
        f"did you mean {' or '.join(near)}?"
        if near
        else "without a name all works are printed, with their names"
    )
    return f"no method, code, figure or work is called {name[:40]!r}; {right}"


def _families(named: Iterable[str]) -> list[str]:
    """Shorten names that differ by their number only, as those of a table of codes."""
    stems: dict[str, list[str]] = {}
    for name in named:
        stem, dash, number = name.rpartition("-")
        stems.setdefault(f"{stem}-*" if dash and number.isdigit() else name, []).append(name)
    return [stem if len(members) > 2 else ", ".join(members) for stem, members in stems.items()]
