"""A recording read from Python: its plays, the code and PSF as achieved, and that files are whole
or none."""

import numpy as np
import pytest

from cep.files.code_files import read_code
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.shutter.playback import playback_files, read_playback
from hw.export import EXPORTERS
from hw.program import Program
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

PROGRAM = Program("110100100011", chip_ns=200_000)
PATH = Trajectory.straight(20.0)


@pytest.fixture
def recording(tmp_path):
    file = tmp_path / "played.vcd"
    file.write_text(EXPORTERS["vcd"].export(PROGRAM))
    return file


def test_the_code_that_was_played_and_its_psf_are_saved(recording, tmp_path):
    found = read_playback(recording, PROGRAM, signal="shutter")
    assert found.wrong == {}
    files = found.save(tmp_path / "seen.json", motion=PATH)
    assert files == playback_files(tmp_path / "seen.json", with_psf=True)
    assert all(file.is_file() for file in files)
    assert read_code(tmp_path / "seen.json").code == found.code
    assert found.code.bits == PROGRAM.bits
    psf = np.load(tmp_path / "seen_psf.npy")  # float32
    np.testing.assert_allclose(psf, coded_psf(PATH, found.code, size=PSF_PX), atol=1e-6)


def test_a_code_with_its_chip_time_is_a_program(recording):
    code = ShutterCode(PROGRAM.bits, PROGRAM.chip_ns)
    found = read_playback(recording, code)
    assert found.program == PROGRAM
    np.testing.assert_allclose(found.psf(PATH), coded_psf(PATH, code, size=PSF_PX), atol=1e-9)


def test_a_play_of_another_code_is_told_by_its_number(recording):
    other = Program("110100100001", chip_ns=200_000)
    found = read_playback(recording, other, signal="shutter")
    assert list(found.wrong) == [1]
    assert not found.to_dict()["played"]
    assert found.code.bits == PROGRAM.bits


def rows(*signals):
    """A CSV of signals at rest low, each as its edges (time_ns, level)."""
    moments = sorted({0, *(time_ns + 1_000_000 for edges in signals for time_ns, _ in edges)})
    level_at = [{time_ns + 1_000_000: level for time_ns, level in edges} for edges in signals]
    levels = [0] * len(signals)
    lines = [",".join(["Time [s]", *(f"D{k}" for k in range(len(signals)))])]
    for moment in moments:
        levels = [
            changes.get(moment, level) for changes, level in zip(level_at, levels, strict=True)
        ]
        lines.append(",".join([f"{moment / 1e9:.9f}", *map(str, levels)]))
    return "\n".join(lines) + "\n"


def test_what_is_assumed_of_a_recording_is_said(tmp_path):
    file = tmp_path / "capture.csv"
    quiet = [(0, 1), (PROGRAM.duration_ns, 0)]
    spike = [(50_000, 0), (51_000, 1)]
    clock = [(50_000 * k, (k + 1) % 2) for k in range(60)]
    inverted = [(-900_000, 1), *((time_ns, 1 - level) for time_ns, level in PROGRAM.edges)]
    for signals, taken, said in [
        ([PROGRAM.edges, quiet], "D0", []),
        (
            [PROGRAM.edges, PROGRAM.edges],
            "D0",
            ["D0 is taken for the shutter's, with most edges; D1 has"],
        ),
        ([PROGRAM.edges, clock], "D1", ["D1 is taken for the shutter's, with most edges; D0 has"]),
        ([sorted([*PROGRAM.edges, *spike])], "D0", ["1 pulses of D0 too short"]),
    ]:
        file.write_text(rows(*signals))
        found = read_playback(file, PROGRAM)
        assert found.signal == taken
        assert [
            warning[: len(words)] for warning, words in zip(found.warnings, said, strict=True)
        ] == said
        assert read_playback(file, PROGRAM, signal="D0").rivals == ()
    file.write_text(rows(inverted).replace("0.000000000,0", "0.000000000,1"))
    assert read_playback(file, PROGRAM).warnings == ["D0 rests high: low is taken for open"]


def test_nothing_is_replaced_unless_asked(recording, tmp_path):
    found = read_playback(recording, PROGRAM, signal="shutter")
    (tmp_path / "seen_psf.npy").write_text("precious")
    with pytest.raises(ValueError, match="--force"):
        found.save(tmp_path / "seen.json", motion=PATH)
    assert not (tmp_path / "seen.json").exists()
    found.save(tmp_path / "seen.json", motion=PATH, force=True)
