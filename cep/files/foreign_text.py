"""Text that others wrote, as names of files and cameras, made safe for each output.

Such a text may hold what the output takes for a command. Every output writes it through its
function here, so that a reader sees the characters themselves. Rich's markup, JSON and HTML need
none: texts are never parsed as markup, and :mod:`json` and Jinja's autoescaping do the rest.
"""

from __future__ import annotations

import re

from motdiff.files.inputs import printable

# what a spreadsheet takes for the beginning of a formula (OWASP, "CSV injection"); some fold the
# full-width signs into the others
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
# numbers with a sign begin as a formula does, and are none
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?(inf|nan)", re.IGNORECASE)
# signs of CommonMark, and of GitHub's tables, strikethrough and formulas
_MARKDOWN = re.compile(r"([\\`*_\[\]<|~$&#])")
# what LaTeX reads as commands, or its fonts lack or take for others
_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "|": r"\textbar{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        '"': "''",
        "–": "--",
        "±": r"$\pm$",
        "×": r"$\times$",
        "²": r"$^2$",
        "µ": r"\textmu{}",
        "≤": r"$\le$",
        "≥": r"$\ge$",
        "→": r"$\to$",
        "…": r"\ldots{}",
        "[": "{[}",
        "*": "{*}",  # at the beginning of a row they would be options of the row before
    }
)


def terminal_line(text: object) -> str:
    r"""Write a text as one line for a terminal: its commands can be seen, and lines are joined.

    Examples
    --------
    >>> terminal_line("two\n  lines \x1b[2J")
    'two lines \\x1b[2J'
    """
    return printable(re.sub(r"\s*[\r\n]\s*", " ", str(text).strip("\r\n")))


def csv_text(text: str) -> str:
    r"""Write the text of a CSV cell, which no spreadsheet takes for a formula.

    Numbers stay numbers.

    Examples
    --------
    >>> csv_text("=1+1"), csv_text("-0.5"), csv_text("-1+1"), csv_text("a=b")
    ("'=1+1", '-0.5', "'-1+1", 'a=b')
    """
    visible = printable(text)
    if _NUMBER.fullmatch(visible) or not visible.lstrip().startswith(_FORMULA):
        return visible
    return f"'{visible}"  # the spreadsheets' own mark of a text


def markdown_text(text: str) -> str:
    r"""Write a text in Markdown, of a table's cell too, as nothing but text.

    Examples
    --------
    >>> markdown_text("a|b <i> *c*")
    'a\\|b \\<i> \\*c\\*'
    """
    return _MARKDOWN.sub(r"\\\1", printable(text))


def latex_text(text: str) -> str:
    r"""Write a text in LaTeX.

    Examples
    --------
    >>> latex_text("R&D, 5 %")
    'R\\&D, 5 \\%'
    """
    return printable(text).translate(_LATEX)


def plot_text(text: str) -> str:
    r"""Write a text into a figure, where a dollar would begin a formula.

    An underscore at the beginning would hide a label from the legend.

    Examples
    --------
    >>> plot_text("$x$"), plot_text("_a")
    ('\\$x\\$', ' _a')
    """
    visible = printable(text).replace("$", r"\$")
    return re.sub("^_", " _", visible)
