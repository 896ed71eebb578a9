"""Coded exposure: shutter codes, their MTF along a trajectory, search, restoration and reports.

Attributes
----------
__version__ : str
    Version of the installed package; "0+unknown" where it runs uninstalled.
"""

from __future__ import annotations

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    # on demand: importlib.metadata is a tenth of what `cep --help` may take
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("coded-exposure")
        except PackageNotFoundError:
            return "0+unknown"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
