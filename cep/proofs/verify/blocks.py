"""Independent check of a proof in blocks: its file, its count of codes, every survivor, and folds
drawn at random.

Nothing of the search is used: other arithmetic (float64, Fourier transforms of whole rings), other
enumeration. The format and the argument are in docs/proofs/README.md.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.proofs.verify.sums import RefusedError

PROOF_SCHEMA = "cep.proof/1"
_VERSION = 1
_MOST_BYTES = 8 * 2**20  # of a file; a thousand blocks have half a megabyte
_CLOSE = 1e-6  # relative: minima are stated to nine digits
_DRAWN = 2**22  # codes judged one by one, at most about
_ROWS = 2**15
_LONGEST_PREFIX = 8  # more would take hours, or gigabytes
_LONGEST_SUFFIX = 9
_SPLITS = {
    0: [0],
    1: [0, 1],
    2: [0, 1, 2],
    3: [1, 2],
    4: [2],
}  # of a sum of four chips into two sums of two


@dataclass(frozen=True)
class ProofVerdict:
    """Outcome of the check.

    Attributes
    ----------
    holds : bool
    reasons : tuple of str
        Checks that passed, and the one that did not.
    chips, fewest_open, most_open : int
    bits : str
        Best code.
    minimum : float
        Its smallest |P|, computed here.
    blocks, codes, survivors : int
    folds, judged : int
        Folds drawn at random and judged again, and the codes on rings that were judged for it one
        by one.
    """

    holds: bool
    reasons: tuple[str, ...]
    chips: int = 0
    fewest_open: int = 0
    most_open: int = 0
    bits: str = ""
    minimum: float = 0.0
    blocks: int = 0
    codes: int = 0
    survivors: int = 0
    folds: int = 0
    judged: int = 0

    def __bool__(self) -> bool:
        return self.holds


def is_proof(path: Path | str) -> bool:
    """Whether a file begins as a proof in blocks does."""
    if not os.path.isfile(
        path
    ):  # to open a pipe may take for ever; bits may be too long for a name
        return False
    try:
        with Path(path).open("rb") as stream:
            first = json.loads(stream.readline(2**16))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(first, dict) and str(first.get("schema", "")).startswith("cep.proof/")


def verify_proof(
    path: Path | str,
    *,
    blocks: int = 4,
    rng: np.random.Generator,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> ProofVerdict:
    """Check a proof: that no block is missing or counted twice, every survivor, and a random
    sample of folds.

    Parameters
    ----------
    path : path
        ``proof.jsonl``.
    blocks : int
        Blocks to draw folds from; each is counted out anew.
    rng : numpy.random.Generator
        Of the draws.
    progress : callable, optional

    Returns
    -------
    ProofVerdict

    Raises
    ------
    ValueError
        If the file is no proof that this version can read.
    OSError
        If it cannot be read.
    """
    header, records = _read(Path(path))
    reasons: list[str] = []
    about: dict[str, Any] = {
        key: int(header[key]) for key in ("chips", "fewest_open", "most_open")
    }
    try:
        codes = _check_count(header, records)
        reasons.append(
            f"{len(records)} blocks follow each other without a gap, and hold all {codes:.6g}"
            " codes once"
        )
        survivors = _check_survivors(header, records, progress)
        if not survivors:
            raise RefusedError("no code survives, so none is the best")
        bits = max(
            survivors, key=lambda one: (round(survivors[one], 7), one.count("1"), -len(one), one)
        )
        highest = max(float(record["bound"]) for record in records)
        if highest > survivors[bits] * (1 + _CLOSE):
            raise RefusedError(
                f"a bound of {highest:.9g} is above the best code's {survivors[bits]:.9g}: it"
                " hides codes"
            )
        reasons.append(
            f"{len(survivors)} survivors have the minima stated, and lie in their blocks"
        )
        drawn = rng.permutation(len(records))[:blocks]
        folds = judged = 0
        for done, index in enumerate(drawn):
            progress(0.2 + 0.8 * done / len(drawn), f"block {index}")
            more = _check_block(header, records[index], rng, _DRAWN // len(drawn))
            folds = folds + more[0]
            judged = judged + more[1]
        reasons.append(
            f"{len(drawn)} blocks counted out anew; {folds} of their folds leave the same"
            " survivors"
        )
    except RefusedError as error:
        return ProofVerdict(False, (*reasons, str(error)), **about, blocks=len(records))
    return ProofVerdict(
        True,
        tuple(reasons),
        **about,
        bits=bits,
        minimum=survivors[bits],
        blocks=len(records),
        codes=codes,
        survivors=len(survivors),
        folds=folds,
        judged=judged,
    )


def _read(path: Path) -> tuple[Mapping[str, Any], list[dict[str, Any]]]:
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: a regular file is needed")
    with path.open("rb") as stream:
        data = stream.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ValueError(f"{path}: is too large, a proof has at most {_MOST_BYTES >> 20} MiB")
    lines = []
    for number, line in enumerate(data.splitlines(), 1):
        try:
            lines.append(json.loads(line))
            if not isinstance(lines[-1], dict):
                raise ValueError
        except (ValueError, RecursionError):
            raise ValueError(
                f"{path}: line {number} is damaged, a JSON object is needed"
            ) from None
    header = lines[0] if lines else {}
    if header.get("schema") != PROOF_SCHEMA or header.get("version") != _VERSION:
        raise ValueError(
            f"{path}: {header.get('schema')} of version {header.get('version')} cannot be read, "
            f"{PROOF_SCHEMA} of version {_VERSION} can"
        )
    wanted = ("chips", "fewest_open", "most_open", "ring", "prefix", "blocks", "codes")
    kinds = {"first": int, "until": int, "codes": int, "survivors": str, "minima": str}
    bad = next((key for key in wanted if not isinstance(header.get(key), int)), None)
    if bad is not None:
        raise ValueError(f"{path}: {bad}: must be a whole number")
    for number, record in enumerate(lines[1:], 2):
        bad = next(
            (key for key, kind in kinds.items() if not isinstance(record.get(key), kind)), None
        )
        bound = record.get("bound")
        if not (isinstance(bound, int | float) and 0 <= bound <= header["chips"]):
            bad = "bound"
        if bad is not None:
            raise ValueError(f"{path}: line {number}: {bad} is missing, or no value of it")
    return header, sorted(lines[1:], key=lambda record: record["first"])


def _check_count(header: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> int:
    """Check that blocks are complete and their codes sum to the closed count."""
    ring = header["ring"]
    quarter = header["ring"] // 4
    prefix = header["prefix"]
    prefixes = range(max(1, quarter - _LONGEST_SUFFIX), min(quarter, _LONGEST_PREFIX + 1))
    if ring % 4 or not 12 <= ring <= 64 or ring < header["chips"] or prefix not in prefixes:
        raise RefusedError(
            f"a ring of {ring} chips with a prefix of {prefix} is not valid for {header['chips']}"
            " chips"
        )
    at = 0
    for record in records:
        if record["first"] < at:
            raise RefusedError(
                f"the prefixes {record['first']} to {min(record['until'], at)} are counted twice"
            )
        if record["first"] > at:
            raise RefusedError(f"the block of prefixes {at} to {record['first']} is missing")
        at = record["until"]
    if at != 5**prefix:
        raise RefusedError(f"the block of prefixes {at} to {5**prefix} is missing")
    closed = sum(
        comb(ring, opened) for opened in range(header["fewest_open"], header["most_open"] + 1)
    )
    total = sum(record["codes"] for record in records)
    if total != closed:
        raise RefusedError(f"the blocks hold {total} codes, there are {closed}")
    return closed


def _check_survivors(
    header: Mapping[str, Any],
    records: Sequence[Mapping[str, Any]],
    progress: Callable[[float, str], None],
) -> dict[str, float]:
    """Judge every survivor again; return their minima."""
    ring = header["ring"]
    prefix = header["prefix"]
    found: dict[str, float] = {}
    for done, record in enumerate(records):
        progress(0.2 * done / len(records), "survivors")
        names = record["survivors"].split()
        stated = record["minima"].split()
        if len(names) != len(stated):
            raise RefusedError(
                f"block {record['first']}: {len(names)} survivors with {len(stated)} minima"
            )
        for bits, text in zip(names, stated, strict=True):
            inside = (
                set(bits) <= {"0", "1"}
                and bits[0] == bits[-1] == "1"
                and len(bits) <= header["chips"]
            )
            if not inside or not header["fewest_open"] <= bits.count("1") <= header["most_open"]:
                raise RefusedError(f"block {record['first']}: {bits} is no code of this problem")
            value = _minimum(bits)
            if abs(value - float(text)) > _CLOSE * value or value < record["bound"] * (1 - _CLOSE):
                raise RefusedError(
                    f"{bits} has a minimum of {value:.9g}, not {text} above {record['bound']:.9g}"
                )
            place = _number(_canonical(_fold(bits, ring))[:prefix])
            if not record["first"] <= place < record["until"]:
                raise RefusedError(
                    f"{bits} belongs to another block than that of prefixes {record['first']} on"
                )
            if bits in found or bits[::-1] in found:
                raise RefusedError(f"{bits} is listed twice")
            found[bits] = value
    return found


def _check_block(
    header: Mapping[str, Any], record: Mapping[str, Any], rng: np.random.Generator, budget: int
) -> tuple[int, int]:
    """Count a block out, and judge folds drawn from it; return how many, and the codes judged one
    by one.
    """
    quarter = header["ring"] // 4
    folds = _folds(header, record)
    turns = product((1, -1), range(quarter))
    images = np.stack([_numbers(np.roll(folds[:, ::way], -turn, axis=1)) for way, turn in turns])
    ways = np.array([1, 4, 6, 4, 1])[folds].prod(axis=1)
    orbits = 1 + (np.diff(np.sort(images, axis=0), axis=0) > 0).sum(axis=0)  # images that differ
    if int((ways * orbits).sum()) != record["codes"]:
        raise RefusedError(
            f"the block of prefixes {record['first']} holds {int((ways * orbits).sum())} codes"
        )
    listed: dict[tuple[int, ...], set[str]] = {}
    for bits in record["survivors"].split():
        listed.setdefault(tuple(_canonical(_fold(bits, header["ring"]))), set()).add(bits)
    # the folds of survivors first: those the search must not miss
    order = rng.permutation(len(folds)).tolist()
    order.sort(key=lambda row: tuple(folds[row].tolist()) not in listed)
    done = judged = 0
    for row in order:
        if judged >= budget:
            break
        fold = tuple(folds[row].tolist())
        left, more = _judged(np.array(fold), header["chips"], float(record["bound"]))
        if left != listed.get(fold, set()):
            other = sorted(left ^ listed.get(fold, set()))[0]
            raise RefusedError(
                f"block {record['first']}: {other} is a survivor in one count and none in the"
                " other"
            )
        done = done + 1
        judged = judged + more
    return done, judged


def _folds(header: Mapping[str, Any], record: Mapping[str, Any]) -> NDArray[np.int64]:
    """All folds of a block that none of their rotations and mirror images exceeds, (R, q)."""
    quarter = header["ring"] // 4
    prefix = header["prefix"]
    behind = (
        np.arange(5 ** (quarter - prefix))[:, None] // 5 ** np.arange(quarter - prefix)[::-1] % 5
    )
    parts = [np.zeros((0, quarter), np.int64)]
    for number in range(record["first"], record["until"]):
        front = np.array([number // 5**place % 5 for place in reversed(range(prefix))])
        if (front > front[0]).any():
            continue
        some = behind[(behind <= front[0]).all(axis=1)]
        opened = front.sum() + some.sum(axis=1)
        some = some[(opened >= header["fewest_open"]) & (opened <= header["most_open"])]
        rows = np.concatenate([np.tile(front, (len(some), 1)), some], axis=1)
        for way, turn in product((1, -1), range(quarter)):
            rows = rows[_numbers(np.roll(rows[:, ::way], -turn, axis=1)) <= _numbers(rows)]
        parts.append(rows)
    return np.concatenate(parts)


def _judged(fold: NDArray[np.int64], chips: int, bound: float) -> tuple[set[str], int]:
    """Judge all codes of a fold; return the cores of those that reach the bound, and the number of
    rings judged.
    """
    least = bound * (1 - 1e-9) - 1e-9
    quarter = fold.size
    if np.abs(np.fft.fft(fold))[1:].min() < least:
        return set(), 0
    front = np.array(list(product(*(_SPLITS[value] for value in fold.tolist()))), dtype=np.int64)
    halves = np.concatenate([front, fold - front], axis=1)
    # a turn by a quarter of the ring swaps the two parts
    halves = halves[_numbers(halves[:, :quarter], 3) >= _numbers(halves[:, quarter:], 3)]
    kept: set[str] = set()
    judged = 0
    odd = np.arange(1, 2 * quarter, 2)
    for at in range(0, len(halves), _ROWS):
        part = halves[at : at + _ROWS]
        part = part[np.abs(np.fft.fft(part, axis=1))[:, 1:].min(axis=1) >= least]
        for half in part:
            single = np.flatnonzero(half == 1)
            both = np.flatnonzero(half == 2)
            if not single.size:
                continue
            waves = np.exp(-2j * np.pi * np.outer(single, odd) / (4 * quarter))
            for low in range(0, 2 ** (single.size - 1), _ROWS):
                count = np.arange(low, min(low + _ROWS, 2 ** (single.size - 1)))
                first = (
                    count[:, None] >> np.arange(single.size)
                ) & 1  # the last is always behind: half a turn
                judged += len(count)
                sums = (2.0 * first - 1) @ waves.real, (2.0 * first - 1) @ waves.imag
                for chosen in first[np.hypot(*sums).min(axis=1) >= least]:
                    ring = np.zeros(4 * quarter, dtype=np.int64)
                    ring[both] = ring[both + 2 * quarter] = 1
                    ring[single + 2 * quarter * (1 - chosen)] = 1
                    kept |= _turned(ring, chips, bound)
    return kept, judged


def _turned(ring: NDArray[np.int64], chips: int, bound: float) -> set[str]:
    """Judge the codes that a ring holds, one from each open chip on."""
    size = ring.size
    codes = np.stack([np.roll(ring, -start) for start in np.flatnonzero(ring)])
    codes = codes[~codes[:, chips:].any(axis=1)]
    if not len(codes):
        return set()
    codes = codes[
        np.abs(np.fft.rfft(codes, 8 * size, axis=1)).min(axis=1) >= bound * (1 - 1e-9) - 1e-9
    ]
    cores = ("".join(map(str, code)).rstrip("0") for code in codes.tolist())
    return {max(bits, bits[::-1]) for bits in cores if _minimum(bits) >= bound * (1 - 1e-8)}


def _minimum(bits: str) -> float:
    """Smallest |P| on the unit circle, by sampling and golden sections about the lowest
    samples.
    """
    code = np.array([int(bit) for bit in bits])
    size = 64 * len(bits)
    sampled = np.abs(np.fft.rfft(code, size))
    inner = np.r_[sampled[1], sampled, sampled[-2]]
    local = np.flatnonzero((inner[1:-1] <= inner[:-2]) & (inner[1:-1] <= inner[2:]))
    local = local[np.argsort(sampled[local])[:12]]
    places = np.flatnonzero(code).astype(np.longdouble)

    def look(turns: NDArray[Any]) -> NDArray[Any]:
        angle = 2 * np.longdouble(np.pi) * np.outer(turns, places)
        return np.asarray(np.hypot(np.cos(angle).sum(axis=1), np.sin(angle).sum(axis=1)))

    low = (local - 1) / np.longdouble(size)
    high = (local + 1) / np.longdouble(size)
    share = (np.sqrt(np.longdouble(5)) - 1) / 2
    for _ in range(60):
        a = high - share * (high - low)
        b = low + share * (high - low)
        left = look(a) < look(b)
        low = np.where(left, low, a)
        high = np.where(left, b, high)
    return float(min(look((low + high) / 2).min(), sampled.min()))


def _fold(bits: str, ring: int) -> list[int]:
    chips = np.array([int(bit) for bit in bits.ljust(ring, "0")])
    return [int(value) for value in chips.reshape(4, ring // 4).sum(axis=0)]


def _canonical(fold: list[int]) -> list[int]:
    """Return the largest of a fold's rotations and mirror images."""
    return max(way[k:] + way[:k] for way in (fold, fold[::-1]) for k in range(len(fold)))


def _number(letters: Sequence[int]) -> int:
    return int("".join(map(str, letters)), 5)


def _numbers(rows: NDArray[np.int64], base: int = 5) -> NDArray[np.int64]:
    return np.asarray(rows @ base ** np.arange(rows.shape[1])[::-1], dtype=np.int64)
