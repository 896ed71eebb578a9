"""Tables for people, printed at several widths and checked."""

import io
import re

from rich.console import Console

WIDTHS = (60, 80, 120)


def rendered(made, width):
    """Print a table on a console of so many columns."""
    stream = io.StringIO()
    Console(width=width, highlight=False, soft_wrap=True, file=stream).print(made)
    return stream.getvalue()


def check(made):
    """Read every table at every width: names are whole, heads are there or named as left out,
    lines fit."""
    for width in WIDTHS:
        text = rendered(made, width)
        page, _, left_out = text.partition("left out, as ")
        assert max(map(len, page.splitlines())) <= width
        words = page.split()
        for name in (str(row[0]) for row in made.rows):
            # folded where it is longer than the narrowest column of names
            pieces = [piece for word in name.split() for piece in re.findall(".{1,16}", word)]
            joined = "".join(words)
            assert all(piece in words or piece in joined for piece in pieces), (name, text)
        for head in made.columns:
            assert all(word in words for word in head.split()) or head in left_out, (head, text)
        if width == 120:
            assert not left_out
