"""Independent check of a proof in blocks: counts, every survivor, and folds drawn at random.

Nothing of the search is used: other arithmetic (float64, Fourier transforms of whole rings), other
enumeration. The format and the argument are in docs/proofs/README.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SCHEMA = "cep.proof/1"
_VERSION = 1
_MOST_BYTES = 8 * 2**20  # of a file; a thousand blocks have half a megabyte
_CLOSE = 1e-6  # relative: minima are stated to nine digits
_MOST_JUDGED = 2**22  # codes judged one by one, about: minutes
_ROWS = 2**15
_LONGEST_PREFIX = 8  # 5^9 blocks would take hours, or gigabytes
_LONGEST_SUFFIX = 9
# first parts of a sum of four chips that is split into two sums of two chips
_SPLITS = {0: [0], 1: [0, 1], 2: [0, 1, 2], 3: [1, 2], 4: [2]}


class RefusedError(Exception):
    """A claim does not hold; the message says why."""


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
        Folds drawn at random and judged again, and codes judged for it one by one.
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


def verify_proof(
    path: Path | str,
    *,
    blocks: int = 4,
    rng: np.random.Generator,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> ProofVerdict:
    """Check that no block is missing or counted twice, every survivor, and some folds again.

    Parameters
    ----------
    path : path
        ``proof.jsonl``.
    blocks : int
        Blocks to draw folds from; each is counted out anew.
    rng : numpy.random.Generator
        Of the draws.
    progress : callable, optional

    Raises
    ------
    ValueError
        If the file is no proof that this version can read.
    OSError
        If it cannot be read.
    """
    header, records = _read(Path(path))
    reasons: list[str] = []
    problem: dict[str, Any] = {
        key: int(header[key]) for key in ("chips", "fewest_open", "most_open")
    }
    try:
        codes = _check_count(header, records)
        reasons.append(
            f"{len(records)} blocks follow each other without a gap, and hold all {codes:.6g}"
            " codes once"
        )
        minima = _check_survivors(header, records, progress)
        if not minima:
            raise RefusedError("no code survives, so none is the best")
        best = max(
            minima, key=lambda bits: (round(minima[bits], 7), bits.count("1"), -len(bits), bits)
        )
        highest = max(float(record["bound"]) for record in records)
        if highest > minima[best] * (1 + _CLOSE):
            raise RefusedError(
                f"a bound of {highest:.9g} is above the best code's {minima[best]:.9g}: it"
                " hides codes"
            )
        reasons.append(f"{len(minima)} survivors have the minima stated, and lie in their blocks")
        sample = rng.permutation(len(records))[:blocks]
        folds = judged = 0
        for number, index in enumerate(sample):
            progress(0.2 + 0.8 * number / len(sample), f"block {index}")
            block = _check_block(header, records[index], rng, _MOST_JUDGED // len(sample))
            folds += block[0]
            judged += block[1]
        reasons.append(
            f"{len(sample)} blocks counted out anew; {folds} of their folds leave the same"
            " survivors"
        )
    except RefusedError as error:
        return ProofVerdict(False, (*reasons, str(error)), **problem, blocks=len(records))
    return ProofVerdict(
        True,
        tuple(reasons),
        **problem,
        bits=best,
        minimum=minima[best],
        blocks=len(records),
        codes=codes,
        survivors=len(minima),
        folds=folds,
        judged=judged,
    )


def _read(path: Path) -> tuple[Mapping[str, Any], list[dict[str, Any]]]:
    if path.exists() and not path.is_file():  # opening a pipe may take for ever
        raise ValueError(f"{path}: a regular file is needed")
    with path.open("rb") as stream:
        content = stream.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise ValueError(f"{path}: is too large, a proof has at most {_MOST_BYTES >> 20} MiB")
    lines = []
    for number, line in enumerate(content.splitlines(), 1):
        try:
            lines.append(json.loads(line))
            if not isinstance(lines[-1], dict):
                raise ValueError
        except (ValueError, RecursionError):
            raise ValueError(
                f"{path}: line {number} is damaged, a JSON object is needed"
            ) from None
    header = lines[0] if lines else {}
    if header.get("schema") != _SCHEMA or header.get("version") != _VERSION:
        raise ValueError(
            f"{path}: {header.get('schema')} of version {header.get('version')} cannot be read, "
            f"{_SCHEMA} of version {_VERSION} can"
        )
    for key in ("chips", "fewest_open", "most_open", "ring", "prefix", "blocks", "codes"):
        if not isinstance(header.get(key), int):
            raise ValueError(f"{path}: {key}: must be a whole number")
    for number, record in enumerate(lines[1:], 2):
        if (field := _faulty_field(record, header["chips"])) is not None:
            raise ValueError(f"{path}: line {number}: {field} is missing, or no value of it")
    return header, sorted(lines[1:], key=lambda record: record["first"])


def _faulty_field(record: Mapping[str, Any], chips: int) -> str | None:
    bound = record.get("bound")
    if not (isinstance(bound, int | float) and 0 <= bound <= chips):
        return "bound"
    types = {"first": int, "until": int, "codes": int, "survivors": str, "minima": str}
    return next(
        (key for key, kind in types.items() if not isinstance(record.get(key), kind)), None
    )


def _check_count(header: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> int:
    """Check that blocks are complete and their codes sum to the closed count."""
    ring = header["ring"]
    quarter = ring // 4
    prefix = header["prefix"]
    prefixes = range(max(1, quarter - _LONGEST_SUFFIX), min(quarter, _LONGEST_PREFIX + 1))
    if ring % 4 or not 12 <= ring <= 64 or ring < header["chips"] or prefix not in prefixes:
        raise RefusedError(
            f"a ring of {ring} chips with a prefix of {prefix} is not valid for {header['chips']}"
            " chips"
        )
    covered = 0
    for record in records:
        if record["first"] < covered:
            raise RefusedError(
                f"the prefixes {record['first']} to {min(record['until'], covered)} are counted"
                " twice"
            )
        if record["first"] > covered:
            raise RefusedError(f"the block of prefixes {covered} to {record['first']} is missing")
        covered = record["until"]
    if covered != 5**prefix:
        raise RefusedError(f"the block of prefixes {covered} to {5**prefix} is missing")
    open_range = range(header["fewest_open"], header["most_open"] + 1)
    closed_count = sum(comb(ring, open_chips) for open_chips in open_range)
    total = sum(record["codes"] for record in records)
    if total != closed_count:
        raise RefusedError(f"the blocks hold {total} codes, there are {closed_count}")
    return closed_count


def _check_survivors(
    header: Mapping[str, Any],
    records: Sequence[Mapping[str, Any]],
    progress: Callable[[float, str], None],
) -> dict[str, float]:
    """Judge every survivor again; return their minima."""
    minima: dict[str, float] = {}
    for number, record in enumerate(records):
        progress(0.2 * number / len(records), "survivors")
        codes = record["survivors"].split()
        recorded = record["minima"].split()
        if len(codes) != len(recorded):
            raise RefusedError(
                f"block {record['first']}: {len(codes)} survivors with {len(recorded)} minima"
            )
        for bits, text in zip(codes, recorded, strict=True):
            is_core = (
                set(bits) <= {"0", "1"}
                and bits[0] == bits[-1] == "1"
                and len(bits) <= header["chips"]
            )
            if not is_core or not header["fewest_open"] <= bits.count("1") <= header["most_open"]:
                raise RefusedError(f"block {record['first']}: {bits} is no code of this problem")
            minimum = _minimum(bits)
            if abs(minimum - float(text)) > _CLOSE * minimum or minimum < record["bound"] * (
                1 - _CLOSE
            ):
                raise RefusedError(
                    f"{bits} has a minimum of {minimum:.9g}, not {text} above"
                    f" {record['bound']:.9g}"
                )
            prefix = _number(_canonical(_fold(bits, header["ring"]))[: header["prefix"]])
            if not record["first"] <= prefix < record["until"]:
                raise RefusedError(
                    f"{bits} belongs to another block than that of prefixes {record['first']} on"
                )
            if bits in minima or bits[::-1] in minima:
                raise RefusedError(f"{bits} is listed twice")
            minima[bits] = minimum
    return minima


def _check_block(
    header: Mapping[str, Any], record: Mapping[str, Any], rng: np.random.Generator, budget: int
) -> tuple[int, int]:
    """Count a block out, and judge folds drawn from it.

    Returns
    -------
    int, int
        Folds judged, and codes judged one by one: about ``budget``.
    """
    folds = _folds(header, record)
    turns = product((1, -1), range(header["ring"] // 4))
    images = np.stack(
        [_numbers(np.roll(folds[:, ::step], -shift, axis=1)) for step, shift in turns]
    )
    splits = np.array([1, 4, 6, 4, 1])[folds].prod(axis=1)  # of each sum into four chips
    orbits = 1 + (np.diff(np.sort(images, axis=0), axis=0) > 0).sum(axis=0)  # images that differ
    if int((splits * orbits).sum()) != record["codes"]:
        raise RefusedError(
            f"the block of prefixes {record['first']} holds {int((splits * orbits).sum())} codes"
        )
    recorded: dict[tuple[int, ...], set[str]] = {}
    for bits in record["survivors"].split():
        recorded.setdefault(tuple(_canonical(_fold(bits, header["ring"]))), set()).add(bits)
    # the folds of survivors first: those the search must not miss
    order = rng.permutation(len(folds)).tolist()
    order.sort(key=lambda row: tuple(folds[row].tolist()) not in recorded)
    judged_folds = judged_codes = 0
    for row in order:
        if judged_codes >= budget:
            break
        fold = tuple(folds[row].tolist())
        survivors, codes = _judge_fold(np.array(fold), header["chips"], float(record["bound"]))
        if survivors != recorded.get(fold, set()):
            bits = sorted(survivors ^ recorded.get(fold, set()))[0]
            raise RefusedError(
                f"block {record['first']}: {bits} is a survivor in one count and none in the other"
            )
        judged_folds += 1
        judged_codes += codes
    return judged_folds, judged_codes


def _folds(header: Mapping[str, Any], record: Mapping[str, Any]) -> NDArray[np.int64]:
    """All folds of a block that none of their rotations and mirror images exceeds, (R, q)."""
    quarter = header["ring"] // 4
    prefix = header["prefix"]
    suffixes = (
        np.arange(5 ** (quarter - prefix))[:, None] // 5 ** np.arange(quarter - prefix)[::-1] % 5
    )
    folds = [np.zeros((0, quarter), np.int64)]
    for number in range(record["first"], record["until"]):
        front = np.array([number // 5**place % 5 for place in reversed(range(prefix))])
        if (front > front[0]).any():
            continue
        back = suffixes[(suffixes <= front[0]).all(axis=1)]
        open_chips = front.sum() + back.sum(axis=1)
        back = back[(open_chips >= header["fewest_open"]) & (open_chips <= header["most_open"])]
        rows = np.concatenate([np.tile(front, (len(back), 1)), back], axis=1)
        # one image after the other: all at once took 1.5 GB
        for step, shift in product((1, -1), range(quarter)):
            image = np.roll(rows[:, ::step], -shift, axis=1)
            rows = rows[_numbers(image) <= _numbers(rows)]
        folds.append(rows)
    return np.concatenate(folds)


def _judge_fold(fold: NDArray[np.int64], chips: int, bound: float) -> tuple[set[str], int]:
    """Judge all codes of a fold.

    Returns
    -------
    set of str, int
        Cores of the codes that reach the bound, and the number of rings judged.
    """
    limit = bound * (1 - 1e-9) - 1e-9
    quarter = fold.size
    if np.abs(np.fft.fft(fold))[1:].min() < limit:
        return set(), 0
    front = np.array(list(product(*(_SPLITS[value] for value in fold.tolist()))), dtype=np.int64)
    halves = np.concatenate([front, fold - front], axis=1)
    # a turn by a quarter of the ring swaps the two halves
    halves = halves[_numbers(halves[:, :quarter], 3) >= _numbers(halves[:, quarter:], 3)]
    survivors: set[str] = set()
    judged_codes = 0
    odd = np.arange(1, 2 * quarter, 2)
    for row in range(0, len(halves), _ROWS):
        batch = halves[row : row + _ROWS]
        batch = batch[np.abs(np.fft.fft(batch, axis=1))[:, 1:].min(axis=1) >= limit]
        for half in batch:
            single = np.flatnonzero(half == 1)
            double = np.flatnonzero(half == 2)
            if not single.size:
                continue
            waves = np.exp(-2j * np.pi * np.outer(single, odd) / (4 * quarter))
            for low in range(0, 2 ** (single.size - 1), _ROWS):
                index = np.arange(low, min(low + _ROWS, 2 ** (single.size - 1)))
                # the last single chip is always in the second half: half a turn is free
                in_front = (index[:, None] >> np.arange(single.size)) & 1
                judged_codes += len(index)
                sums = (2.0 * in_front - 1) @ waves.real, (2.0 * in_front - 1) @ waves.imag
                for chosen in in_front[np.hypot(*sums).min(axis=1) >= limit]:
                    ring = np.zeros(4 * quarter, dtype=np.int64)
                    ring[double] = ring[double + 2 * quarter] = 1
                    ring[single + 2 * quarter * (1 - chosen)] = 1
                    survivors |= _judge_ring(ring, chips, bound)
    return survivors, judged_codes


def _judge_ring(ring: NDArray[np.int64], chips: int, bound: float) -> set[str]:
    """Judge the codes that a ring holds, one from each open chip on."""
    codes = np.stack([np.roll(ring, -start) for start in np.flatnonzero(ring)])
    codes = codes[~codes[:, chips:].any(axis=1)]
    if not len(codes):
        return set()
    minima = np.abs(np.fft.rfft(codes, 8 * ring.size, axis=1)).min(axis=1)
    codes = codes[minima >= bound * (1 - 1e-9) - 1e-9]
    cores = ("".join(map(str, code)).rstrip("0") for code in codes.tolist())
    return {max(bits, bits[::-1]) for bits in cores if _minimum(bits) >= bound * (1 - 1e-8)}


def _minimum(bits: str) -> float:
    """Smallest |P| on the unit circle: golden sections about the lowest of dense samples."""
    code = np.array([int(bit) for bit in bits])
    size = 64 * len(bits)
    sampled = np.abs(np.fft.rfft(code, size))
    padded = np.r_[sampled[1], sampled, sampled[-2]]
    local = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
    local = local[np.argsort(sampled[local])[:12]]
    places = np.flatnonzero(code).astype(np.longdouble)

    def modulus(frequency: NDArray[Any]) -> NDArray[Any]:
        """|P| at frequencies in cycles a chip."""
        angle = 2 * np.longdouble(np.pi) * np.outer(frequency, places)
        return np.asarray(np.hypot(np.cos(angle).sum(axis=1), np.sin(angle).sum(axis=1)))

    low = (local - 1) / np.longdouble(size)
    high = (local + 1) / np.longdouble(size)
    golden = (np.sqrt(np.longdouble(5)) - 1) / 2
    for _ in range(60):  # 0.618^60 is below the last digit
        a = high - golden * (high - low)
        b = low + golden * (high - low)
        in_left = modulus(a) < modulus(b)
        low = np.where(in_left, low, a)
        high = np.where(in_left, b, high)
    return float(min(modulus((low + high) / 2).min(), sampled.min()))


def _fold(bits: str, ring: int) -> list[int]:
    chips = np.array([int(bit) for bit in bits.ljust(ring, "0")])
    return [int(value) for value in chips.reshape(4, ring // 4).sum(axis=0)]


def _canonical(fold: list[int]) -> list[int]:
    """Return the largest of a fold's rotations and mirror images."""
    return max(image[k:] + image[:k] for image in (fold, fold[::-1]) for k in range(len(fold)))


def _number(sums: Sequence[int]) -> int:
    return int("".join(map(str, sums)), 5)


def _numbers(rows: NDArray[np.int64], base: int = 5) -> NDArray[np.int64]:
    return np.asarray(rows @ base ** np.arange(rows.shape[1])[::-1], dtype=np.int64)
