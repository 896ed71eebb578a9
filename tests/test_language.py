"""Names say which quantity they hold: the vague ones of each room are counted, and only shrink."""

import ast
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

WORDS = """
found kept told shown taken known given made drawn seen said asked sought wanted turned opened
closed left own one other others each every everything both none whole some many most least part
rest way ways here there then now again alone together behind like near far still sure worth
begins begun began ends ended been held tried judged moved lit spent used done stated named put
sent mine wish ahead
"""
VAGUE = frozenset(WORDS.split())
"""Pronouns, participles and everyday words: no field has such a word for a quantity."""

MOST = {
    "cep/calibration": 1,
    "cep/proofs": 1,
    "cep/search": 4,
    "lab/bench": 4,
    "lab/block_proofs": 10,
    "lab/fronts": 1,
    "lab/jobs": 2,
    "motdiff/estimators": 1,
}
"""The vague names that a room still has; one that is missing here has none."""


def bound_names(tree):
    """Yield each name that is assigned to, and each parameter."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def vague_names():
    counts = Counter()
    for package in ("cep", "motdiff", "hw", "lab"):
        for path in (ROOT / package).rglob("*.py"):
            room = "/".join(path.relative_to(ROOT).parts[:2])
            names = bound_names(ast.parse(path.read_text(encoding="utf-8")))
            counts[room] += sum(name.strip("_") in VAGUE for name in names)
    return counts


COUNTS = vague_names()


@pytest.mark.parametrize("room", sorted(room for room, count in COUNTS.items() if count))
def test_a_room_gets_no_new_vague_names(room):
    assert COUNTS[room] <= MOST.get(room, 0), f"{room}: name the quantity"


def test_no_room_has_fewer_than_are_allowed():
    assert {room: most for room, most in MOST.items() if COUNTS[room] < most} == {}, (
        "lower the figures"
    )


def test_a_vague_name_is_counted():
    names = list(bound_names(ast.parse("def f(found, kernel):\n    one, H = found\n")))
    assert [name for name in names if name in VAGUE] == ["found", "one"]
