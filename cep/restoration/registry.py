"""Restorations by name, with what the command line and the documentation say of each.

Another restoration is a function ``(photo, psf, **options)`` in a file of its own, and an entry in
the list below. The functions are imported when they are first used: help pages read the list.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from motdiff.files.plugins import is_reference, load_object

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from motdiff.types import FloatArray


@dataclass(frozen=True)
class Method:
    """A restoration of the product.

    Attributes
    ----------
    name : str
        As ``--method`` has it.
    about : str
        What it is, in a few words, for the help page.
    source : str
        ``module:name`` of its function.
    cites : tuple of str
        Keys of ``cep/files/works.bib``.
    uses_camera : bool
        Whether it takes ``camera``, for the variance of the noise.
    reports_progress : bool
        Whether it takes ``progress``, a function that it calls with the finished share.
    fills_clipped : bool
        Whether :func:`cep.restoration.restore.restore` fills clipped pixels before it, see
        :func:`cep.restoration.clipping.fill_clipped`; False for one that handles them itself.
    """

    name: str
    about: str
    source: str
    cites: tuple[str, ...] = ()
    uses_camera: bool = False
    reports_progress: bool = False
    fills_clipped: bool = True

    @property
    def function(self) -> Callable[..., FloatArray]:
        """The function, imported."""
        module, _, name = self.source.partition(":")
        function: Callable[..., FloatArray] = getattr(import_module(module), name)
        return function


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "wiener",
            "least mean square error",
            "cep.restoration.wiener:wiener",
            ("wiener1949", "field1987"),
            uses_camera=True,
        ),
        Method(
            "tv",
            "total variation",
            "cep.restoration.tv:tv",
            ("wang2008", "krishnan2009", "wen2021pmp"),
        ),
        Method(
            "pnp",
            "a trained denoiser",
            "cep.restoration.plug_and_play:pnp",
            ("venkatakrishnan2013", "zhang2022dpir", "zhang2018ffdnet", "mohan2020"),
            uses_camera=True,
            reports_progress=True,
        ),
    )
}

_MOVED = {
    "inverse": "which moved to the laboratory, in the repository:"
    " lab.rivals.inverse_filter:inverse_filter"
}

AUTO_ABOUT = "pnp for a coded photo along its motion, and where the motion fits the photo, else tv"
"""What ``auto`` is, for the help page: :func:`cep.restoration.choice.choose_method`."""


def find_method(method: str | Callable[..., ArrayLike]) -> tuple[str, Callable[..., Any]]:
    """Return the name and the function of a restoration; ValueError if there is no such method.

    Parameters
    ----------
    method : str or callable
        A name of :data:`METHODS`, ``module:name`` of a function of your own, or a function.
    """
    if callable(method):
        return getattr(method, "__name__", type(method).__name__), method
    if method in METHODS:
        return method, METHODS[method].function
    if not is_reference(method):
        line = f"method: must be one of {', '.join(METHODS)}, or module:name, got {method!r}"
        raise ValueError(", ".join(filter(None, (line, _MOVED.get(method)))))
    function = load_object(method)
    if not callable(function):
        raise ValueError(f"method: {method} is no function")
    return method, function


def registered_method(function: Callable[..., Any]) -> Method | None:
    """Return the entry of a function of the product, or None for a user-defined one."""
    return next((method for method in METHODS.values() if function is method.function), None)
