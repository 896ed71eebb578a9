"""Sphinx: the site of the documentation, built by ``make docs`` with warnings as errors and no
outside request.
"""

import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "coded-exposure"
author = "the authors of coded-exposure"
copyright = "the authors of coded-exposure"
release = metadata.version("coded-exposure")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "mathml",
    "command_pages",
    "schema_tables",
    "outside_links",
]
exclude_patterns = ["_build", "_extensions"]
nitpicky = False  # numpydoc's types are English
language = "en"

myst_enable_extensions = ["dollarmath", "deflist", "fieldlist"]
myst_heading_anchors = 4
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False

html_theme = "furo"
html_title = f"coded-exposure {release}"
html_copy_source = False
html_show_sphinx = False
html_static_path: list[str] = []


def _keep_bars(
    _app: Any, _kind: str, _name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    """Keep ``|H|`` of a docstring from being read as a substitution."""
    lines[:] = [re.sub(r"(?<![`\\])\|(\w)\|", r"\\|\1\\|", line) for line in lines]


def setup(app: Any) -> None:
    """Mend docstrings before they are laid out."""
    app.connect("autodoc-process-docstring", _keep_bars)
