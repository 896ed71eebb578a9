"""Reads LaTeX tables back, as far as this project writes them."""

import re

COMMANDS = {
    r"\textbackslash{}": "\\",
    r"\textasciitilde{}": "~",
    r"\textasciicircum{}": "^",
    r"\textbar{}": "|",
    r"\textless{}": "<",
    r"\textgreater{}": ">",
    "''": '"',
    r"$\pm$": "±",
    r"$\times$": "×",
    r"$^2$": "²",
    r"\textmu{}": "µ",
    r"$\le$": "≤",
    r"$\ge$": "≥",
    r"$\to$": "→",
    r"\ldots{}": "…",
    "--": "–",
    r"\&": "&",
    r"\%": "%",
    r"\$": "$",
    r"\#": "#",
    r"\_": "_",
    r"\{": "{",
    r"\}": "}",
    "{[}": "[",
    "{*}": "*",
}
TOKEN = re.compile(
    "|".join(re.escape(one) for one in COMMANDS) + r"|[^\\${}&%#_^~|<>\"\[*]", re.DOTALL
)


def read_latex(text):
    """Read what LaTeX would typeset; a character that it would take for a command fails."""
    found = ""
    at = 0
    while at < len(text):
        token = TOKEN.match(text, at)
        assert token, f"LaTeX does not print {text[at:]!r}"
        found = found + COMMANDS.get(token[0], token[0])
        at = token.end()
    return found


def read_tables(text):
    """Read tabulars with booktabs' rules: (caption, column types, head, rows), bold cells with a
    mark."""
    tables = []
    for body in re.findall(r"\\begin\{table\}(.*?)\\end\{table\}", text, re.DOTALL):
        caption = re.search(r"\\caption\{(.*)\}\n", body)
        sides, inner = re.search(
            r"\\begin\{tabular\}\{([lr]+)\}\n(.*)\\end\{tabular\}", body, re.DOTALL
        ).groups()
        inner = re.fullmatch(
            r"\s*\\toprule\n(.*?)\\midrule\n(.*?)\\bottomrule\n\s*", inner, re.DOTALL
        )
        head, rows = (
            [cells(line) for line in part.strip().splitlines()] for part in inner.groups()
        )
        tables.append((read_latex(caption[1]) if caption else "", sides, head[0], rows))
    return tables


def cells(line):
    line = line.strip()
    assert line.endswith(r"\\")
    found = []
    for cell in (part.strip(" ") for part in re.split(r"(?<!\\)&", line[:-2])):
        parts = re.split(r"\\textbf\{((?:[^{}\\]|\\.)*)\}", cell)
        found.append(
            "".join(
                f"*{read_latex(part)}*" if odd % 2 else read_latex(part)
                for odd, part in enumerate(parts)
            )
        )
    return found
