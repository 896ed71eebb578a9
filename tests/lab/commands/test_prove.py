"""``python -m lab prove``: the proof is kept, continued and checked; its exit codes."""

import errno
import json
from pathlib import Path

import pytest

from lab.block_proofs import prove as module

ASKED = ("prove", "--chips", "14", "--workers", "1", "-o", "kept")
FILE = Path("kept/proof.jsonl")


def test_a_proof_is_kept_continued_and_checked(lab, workplace):
    proof = lab.succeeds(*ASKED)
    assert (proof["proven"], proof["bits"]) == (True, "11111001101010")
    assert (proof["finished"], proof["judged"]) == (proof["blocks"], proof["codes"])
    lines = FILE.read_text()
    assert "proven: no code of at most 14 chips with 1 to 14 open is better" in lab(*ASKED).out
    assert FILE.read_text() == lines
    check = ("prove", "--check", str(FILE), "--blocks", "20")
    verdict = lab.succeeds(*check, "-o", "verdict.json")
    assert verdict == json.loads(Path("verdict.json").read_text())
    assert (verdict["holds"], verdict["bits"]) == (True, "1111100110101")
    assert lab(*check).out.startswith("holds: no code of at most 14 chips with 1 to 14 open")
    assert "a proof for 14 chips" in lab.refuses("prove", "--chips", "15", "-o", "kept")
    FILE.write_text("".join(lines.splitlines(True)[:-1]))
    assert "the proof does not hold: the block of prefixes" in lab.refuses(*check)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("prove", "--chips", "14"), "--chips N and -o FOLDER: both are needed, or --check FILE"),
        ((*ASKED, "--blocks", "2"), "--blocks: needs --check FILE"),
        ((*ASKED, "--open", "15"), "--open: must lie within 1..14"),
        (("prove", "--check", "p.jsonl", "--chips", "14"), "--chips: not valid with --check"),
        (("prove", "--check", "p.jsonl"), "p.jsonl: No such file"),
    ],
)
def test_options_that_do_not_go_together(lab, workplace, options, message):
    assert message in lab.refuses(*options)
    assert not FILE.parent.exists()


def test_an_interrupted_proof_says_how_it_goes_on(lab, workplace, monkeypatch):
    def stopped(*_arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "_judge", stopped)
    lab(*ASKED, "--json")
    assert lab.code == 130
    assert (lab.json["proven"], lab.json["bits"]) == (False, "11111001101010")
    assert "the same command goes on from there" in lab.json["warnings"][0]


def test_a_full_disk_is_named(lab, workplace, monkeypatch):
    def full(_handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    assert lab.fails(*ASKED).endswith("kept/proof.jsonl: No space left on device\n")
