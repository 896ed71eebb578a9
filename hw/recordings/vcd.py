"""Reader of VCD (value change dump)."""

from __future__ import annotations

import re
from collections.abc import Iterator

from hw.recordings.traces import Recording, Signal

_UNIT_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "ps": 1e-3, "fs": 1e-6}
_TIMESCALE = re.compile(r"(1|10|100)(s|ms|us|ns|ps|fs)")
_TIME = re.compile(r"#[0-9]{1,30}")
_DUMPS = {"$dumpvars", "$dumpall", "$dumpon", "$dumpoff", "$end"}
_WORD = re.compile(r"\S+")
# Besides 0 and 1 the states of Verilog (x, z) and VHDL, which leave a level as it is.
_VALUES = frozenset("01xXzZuUwWlLhH-")
_ONE_BIT = frozenset(
    {"wire", "reg", "logic", "bit", "tri", "wand", "wor", "integer", "parameter", "event"}
)


def parse_vcd(text: str, *, source: str = "VCD") -> Recording:
    """Read the one-bit signals of VCD text; vectors, numbers and texts in it are passed over.

    Parameters
    ----------
    text : str
        VCD as sigrok, PulseView, Saleae, simulators or `hw.export.vcd` write it: any timescale,
        any names.
    source : str
        File, for messages.

    Raises
    ------
    ValueError
        If the text is no VCD, was cut short in its header, has no one-bit signal, or contradicts
        itself.
    """
    words = (match.group() for match in _WORD.finditer(text))
    unit_ns, names, codes = _header(words, source)
    if not names:
        raise ValueError(
            f"{source} has no one-bit signal: record the shutter line as a digital channel"
        )
    signals = {code: Signal() for _, code in names}
    start_ns: float | None = None
    now_ns = 0.0
    for word in words:
        if _TIME.fullmatch(word):
            moment_ns = int(word[1:]) * unit_ns
            if start_ns is None:
                start_ns = moment_ns
            elif moment_ns < now_ns:
                raise ValueError(f"{source} goes back in time at {word}: times must increase")
            now_ns = moment_ns
        elif word == "$comment":  # may hold anything, changes too
            while next(words, "$end") != "$end":
                pass
        elif word not in _DUMPS:
            value = word[0]
            code = word[1:]
            if word[0] in "bBrRsS":  # a vector, number or text: its code is the next word
                value = word[-1]
                code = next(words, "")
            if (value not in _VALUES and word[0] not in "rRsS") or code not in codes:
                raise ValueError(
                    f"{source} has {word[:20]!r} among its changes: it is damaged, record again"
                )
            if code in signals:  # else a vector or a number
                signals[code].set(value, now_ns, initial=start_ns is None or now_ns == start_ns)
    begin_ns = now_ns if start_ns is None else start_ns
    traces = (signals[code].trace(name, start_ns=begin_ns, end_ns=now_ns) for name, code in names)
    return Recording(source, tuple(traces))


def _header(words: Iterator[str], source: str) -> tuple[float, list[tuple[str, str]], set[str]]:
    """Read up to $enddefinitions: time unit, (name, code) of one-bit signals, all codes."""
    unit_ns = 0.0
    scopes: list[str] = []
    names: list[tuple[str, str]] = []
    codes: set[str] = set()
    for word in words:
        if not word.startswith("$"):
            if codes or unit_ns or scopes:
                break
            continue  # sigrok-cli puts a remark of its own in front of the file
        body: list[str] = []
        for inner in words:
            if inner == "$end":
                break
            body.append(inner)
        else:
            raise ValueError(f"{source} ends within its header: it was cut short, record again")
        if word == "$timescale":
            scale = _TIMESCALE.fullmatch("".join(body))
            if scale is None:
                raise ValueError(
                    f"{source} has timescale {' '.join(body)[:20]!r}: one like '1 ns' is needed"
                )
            unit_ns = int(scale[1]) * _UNIT_NS[scale[2]]
        elif word == "$scope" and body:
            scopes.append(body[-1])
        elif word == "$upscope" and scopes:
            scopes.pop()
        elif word == "$var":
            if len(body) < 4:
                raise ValueError(
                    f"{source} declares {' '.join(body)[:40]!r}: type, size, code and name are"
                    " needed"
                )
            codes.add(body[2])
            if body[1] == "1" and body[0] in _ONE_BIT:
                names.append((".".join([*scopes, "".join(body[3:])]), body[2]))
        elif word == "$enddefinitions":
            if not unit_ns:
                raise ValueError(f"{source} has no timescale: its times mean nothing without one")
            return unit_ns, names, codes
    raise ValueError(f"{source} is no VCD file: a header that ends with $enddefinitions is needed")
