"""The check of a proof in blocks: it passes true ones, and refuses whatever is missing, doubled or
changed."""

import json
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from cep.search.optima import OPTIMA
from lab.block_proofs import check
from lab.block_proofs.blocks import VERSION, judge_block, plan_blocks
from lab.block_proofs.check import _check_block, verify_proof
from lab.block_proofs.proof_file import SCHEMA

BOUND = 1.3
PROOFS = sorted((Path(__file__).resolve().parents[3] / "docs" / "proofs").glob("*.jsonl"))


@pytest.fixture(scope="module")
def true_lines():
    plan = plan_blocks(20, 8, 13)
    records = [judge_block(20, 8, 13, block.first, block.until, BOUND) for block in plan.blocks]
    return [{"schema": SCHEMA, "version": VERSION, **plan.header()}, *records]


def checked(tmp_path, lines, blocks=16):
    path = tmp_path / "proof.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return verify_proof(path, blocks=blocks, rng=np.random.default_rng(0))


def changed(lines, number, **fields):
    return [line | fields if index == number else line for index, line in enumerate(lines)]


def with_survivor(lines):
    return next(index for index, line in enumerate(lines) if line.get("survivors"))


def test_a_true_proof_holds(tmp_path, true_lines):
    verdict = checked(tmp_path, true_lines)
    assert verdict
    assert (verdict.bits, verdict.blocks) == ("1111100110101", len(true_lines) - 1)
    assert verdict.minimum == pytest.approx(1.362373178, abs=1e-8)
    assert verdict.folds > 100
    # finished blocks come in any order
    assert checked(tmp_path, [true_lines[0], *true_lines[:0:-1]])


def test_a_missing_block_is_refused(tmp_path, true_lines):
    for gone in (1, 3, len(true_lines) - 1):
        verdict = checked(tmp_path, true_lines[:gone] + true_lines[gone + 1 :])
        assert not verdict
        assert "is missing" in verdict.reasons[-1]


def test_a_block_counted_twice_is_refused(tmp_path, true_lines):
    assert "counted twice" in checked(tmp_path, [*true_lines, true_lines[3]]).reasons[-1]
    # one that overlaps the next
    wider = changed(true_lines, 3, until=true_lines[3]["until"] + 1)
    assert "counted twice" in checked(tmp_path, wider).reasons[-1]


def test_a_changed_survivor_is_refused(tmp_path, true_lines):
    at = with_survivor(true_lines)
    names = true_lines[at]["survivors"].split()
    minima = true_lines[at]["minima"].split()
    flipped = names[0][:3] + ("0" if names[0][3] == "1" else "1") + names[0][4:]
    assert (
        "has a minimum of"
        in checked(
            tmp_path, changed(true_lines, at, survivors=" ".join([flipped, *names[1:]]))
        ).reasons[-1]
    )
    higher = changed(
        true_lines, at, minima=" ".join([f"{float(minima[0]) + 0.01:.9f}", *minima[1:]])
    )
    assert "has a minimum of" in checked(tmp_path, higher).reasons[-1]
    # one left out is found where its block is drawn
    left_out = changed(true_lines, at, survivors=" ".join(names[1:]), minima=" ".join(minima[1:]))
    assert "survivor in one count and none in the other" in checked(tmp_path, left_out).reasons[-1]
    elsewhere = 1 + at % (len(true_lines) - 1)
    moved = changed(
        left_out,
        elsewhere,
        **{
            key: f"{true_lines[elsewhere][key]} {true_lines[at][key].split()[0]}"
            for key in ("survivors", "minima")
        },
    )
    assert "belongs to another block" in checked(tmp_path, moved).reasons[-1]


def test_counts_that_do_not_add_up_are_refused(tmp_path, true_lines):
    more = true_lines[2]["codes"] + 1
    assert "the blocks hold" in checked(tmp_path, changed(true_lines, 2, codes=more)).reasons[-1]
    # the sum is right, two blocks are not
    shifted = changed(changed(true_lines, 2, codes=more), 3, codes=true_lines[3]["codes"] - 1)
    assert "holds" in checked(tmp_path, shifted).reasons[-1]
    fewer = changed(true_lines, 0, most_open=14)
    assert "there are" in checked(tmp_path, fewer).reasons[-1]


def test_a_bound_above_the_best_code_is_refused(tmp_path, true_lines):
    empty = next(number for number, line in enumerate(true_lines) if line.get("survivors") == "")
    assert "hides codes" in checked(tmp_path, changed(true_lines, empty, bound=1.4)).reasons[-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 9}, "cannot be read"),
        ({"schema": "cep.proof/9"}, "cannot be read"),
        ({"codes": "many"}, "codes: must be a whole number"),
    ],
)
def test_another_file_is_named(tmp_path, true_lines, change, message):
    with pytest.raises(ValueError, match=message):
        checked(tmp_path, changed(true_lines, 0, **change))


def test_a_damaged_line_is_named(tmp_path, true_lines):
    with pytest.raises(ValueError, match="line 3: bound is missing"):
        checked(
            tmp_path,
            [*true_lines[:2], {key: v for key, v in true_lines[2].items() if key != "bound"}],
        )
    path = tmp_path / "proof.jsonl"
    path.write_text(json.dumps(true_lines[0]) + "\n{")
    with pytest.raises(ValueError, match="line 2 is damaged"):
        verify_proof(path, rng=np.random.default_rng(0))


def test_a_pipe_is_no_proof_and_is_not_opened(tmp_path, monkeypatch):
    """The opening of one that nobody writes to never ends."""
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(Path, "open", lambda *_args: pytest.fail("it was opened"))
    with pytest.raises(ValueError, match="pipe"):
        verify_proof(tmp_path / "pipe", rng=np.random.default_rng(0))


@pytest.mark.parametrize("path", PROOFS, ids=lambda path: path.stem)
def test_published_proofs_hold(path, monkeypatch):
    """Every survivor of eight proofs, a block of each counted out, and folds of 65,000 codes."""
    monkeypatch.setattr(check, "_MOST_JUDGED", 2**16)
    verdict = verify_proof(path, blocks=1, rng=np.random.default_rng(0))
    assert verdict, verdict.reasons[-1]
    assert verdict.bits in {entry.bits for entry in OPTIMA}


def test_the_largest_block_of_a_published_proof_is_counted_out_in_little_memory():
    """All images of all its folds at once took 1.5 GB."""
    lines = [json.loads(line) for line in PROOFS[0].read_text().splitlines()]
    largest = max(lines[1:], key=lambda line: line["folds"])
    tracemalloc.start()
    try:
        _check_block(lines[0], largest, np.random.default_rng(0), 1)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 256 * 2**20


@pytest.mark.parametrize(
    "line",
    [b"[" * 60_000, b'{"a":' * 10_000, b"[" * 10**6, b"1" * 5000, b'{"schema": "cep.proof/1"'],
    ids=repr,
)
def test_lines_that_no_parser_takes_are_refused_by_their_number(tmp_path, true_lines, line):
    path = tmp_path / "proof.jsonl"
    path.write_bytes(json.dumps(true_lines[0]).encode() + b"\n" + line + b"\n")
    with pytest.raises(ValueError, match=r"proof\.jsonl: line 2 is damaged"):
        verify_proof(path, rng=np.random.default_rng(0))


def test_a_file_too_large_is_refused_before_it_is_parsed(tmp_path, true_lines):
    path = tmp_path / "proof.jsonl"
    path.write_text(json.dumps(true_lines[0]) + "\n")
    with path.open("r+b") as stream:
        stream.truncate(2**40)
    with pytest.raises(ValueError, match=r"proof\.jsonl: is too large, a proof has at most 8 MiB"):
        verify_proof(path, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    "fields",
    [
        {"first": 0.5},
        {"until": 1e300},
        {"codes": "9"},
        {"bound": 10**400},
        {"bound": float("nan")},
        {"minima": 3},
    ],
    ids=repr,
)
def test_records_of_other_types_are_refused(tmp_path, true_lines, fields):
    (name,) = fields
    with pytest.raises(ValueError, match=rf"line 4: {name} is missing, or no value of it"):
        checked(tmp_path, changed(true_lines, 3, **fields))


@pytest.mark.parametrize("prefix", [1, 14])
def test_a_header_that_asks_for_endless_work_is_refused(tmp_path, true_lines, prefix):
    header = {**true_lines[0], "ring": 60, "prefix": prefix}
    assert (
        "is not valid"
        in checked(tmp_path, [header, true_lines[1] | {"until": 5**prefix}]).reasons[-1]
    )
