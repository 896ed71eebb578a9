"""Pages of the documentation with transcripts run from top to bottom, and say what they show."""

import pytest
from emulators.tools import require_simavr
from shell_transcripts import ROOT, run_transcript, transcript_of

PAGES = sorted(
    path
    for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    if path.name not in {"command-line.md", "overview.md"}  # written by the build of the site
)
RUN_ELSEWHERE = {"hardware.md"}
"""tests/cep/cli/test_hardware_transcript.py runs it."""


def name_of(page):
    return str(page.relative_to(ROOT))


TRANSCRIPTS = [page for page in PAGES if transcript_of(page) and page.name not in RUN_ELSEWHERE]


@pytest.mark.slow(reason="calibrates, searches and restores as a user would")
@pytest.mark.parametrize("page", TRANSCRIPTS, ids=name_of)
def test_a_page_runs_from_top_to_bottom(page, tmp_path):
    lines = transcript_of(page)
    if any("hw emulate" in line for line in lines):
        require_simavr()
    run_transcript(lines, tmp_path)
