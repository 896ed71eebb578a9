"""Links of documents to files outside ``docs/`` become the names of these files: the site does not
hold them.

Links to pages that the site copies as they are (``html_extra_path``) and to JSON Schemas stay
links, where Sphinx would offer a download.
"""

import os
import re
from pathlib import Path

from sphinx.application import Sphinx

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s:]+)\)")


def _named(app: Sphinx, document: str, source: list[str]) -> None:
    root = Path(app.srcdir).resolve()
    folder = (root / document).parent
    copied = {root / name for name in app.config.html_extra_path}

    def name(match: re.Match[str]) -> str:
        target = (folder / match[2].partition("#")[0]).resolve()
        if target in copied:
            return f'<a href="{os.path.relpath(target, folder)}">{match[1]}</a>'
        if target.parent.name == "schemas":  # schema_tables copies them
            schema = os.path.relpath(root / "schemas" / target.name, folder)
            return f'<a href="{schema}">{match[1]}</a>'
        if target.is_relative_to(root) and not target.is_dir():
            return match[0]
        path = f"`{target.relative_to(root.parent)}`"
        return path if match[1].strip("`") in path else f"{match[1]} ({path})"

    source[0] = _LINK.sub(name, source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Rewrite each document as it is read."""
    app.connect("source-read", _named)
    return {"parallel_read_safe": True}
