"""The transcript in docs/hardware.md, run from the shell as it stands there, against the emulated
Uno."""

import json
import signal

import pytest

if not hasattr(signal, "SIGALRM"):
    pytest.skip("no pseudo-terminals on this system", allow_module_level=True)

from emulators.tools import require_simavr
from shell_transcripts import ROOT, run_transcript, transcript_of


@pytest.mark.slow  # a search and an emulated board
def test_from_the_search_to_the_shutters_edges(tmp_path):
    require_simavr()
    run_transcript(transcript_of(ROOT / "docs" / "hardware.md"), tmp_path)
    sent = json.loads((tmp_path / "code.json").read_text())
    played = json.loads((tmp_path / "played.json").read_text())
    assert played["bits"] == sent["bits"]
    # an emulated pin changes between two instructions: some 200 ns over 20 chips
    assert abs(played["chip_ns"] - sent["chip_ns"]) <= 20
