"""A recording of a shutter compared with its program, and the code and PSF as achieved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cep.files.code_files import StoredCode, write_code
from cep.files.psf_files import PSF_SUFFIXES, write_psf
from cep.optics.code import ShutterCode
from cep.optics.exposure import played_psf
from cep.optics.response import ShutterResponse
from cep.optics.timeline import timeline
from hw.device import DeviceProfile
from hw.program import Program
from hw.recordings.playback import Verification, align
from hw.recordings.recording_file import read_recording
from motdiff.files.outputs import new_folder
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_MOST_EXPOSURES = 1.5  # that a code may take: nothing is known of the motion beyond


@dataclass(frozen=True)
class Playback:
    """Plays of a program in a recording.

    Attributes
    ----------
    program : Program
        That should have been played.
    signal : str
        The shutter's, in the recording.
    plays : tuple of Verification
        One or more.
    rivals : tuple of str
        Signals with edges besides, where the shutter's was not named.
    """

    program: Program
    signal: str
    plays: tuple[Verification, ...]
    rivals: tuple[str, ...] = ()

    @property
    def wrong(self) -> dict[int, Verification]:
        """Plays that differ from the program, by their number, counted from 1."""
        numbered = enumerate(self.plays, start=1)
        return {number: play for number, play in numbered if play.problems or not play.same_bits}

    @property
    def warnings(self) -> list[str]:
        """What was assumed of the recording, one sentence each."""
        short = sum(play.glitches for play in self.plays)
        signals = ", ".join(self.rivals)
        most_edges = (
            f"{self.signal} is taken for the shutter's, with most edges; {signals} has some as"
            " well, --signal names the right one"
        )
        assumed = {
            most_edges: bool(signals),
            f"{self.signal} rests high: low is taken for open": self.plays[0].inverted,
            f"{short} pulses of {self.signal} too short for a chip were passed over": short > 0,
        }
        return [warning for warning, holds in assumed.items() if holds]

    @property
    def code(self) -> ShutterCode:
        """The first play's code, its measured chip time in ns; ValueError if no chip was open."""
        play = self.plays[0]
        chip_ns = self.program.chip_ns * (1 + play.scale_ppm * 1e-6)  # a slow clock: longer chips
        return ShutterCode(play.achieved, max(1, round(chip_ns)))

    def psf(self, motion: Trajectory, *, size: int = PSF_PX) -> FloatArray:
        """PSF of the first play along a motion, (size, size), light-true.

        It sums to the open part of the commanded exposure. A shutter with a slow clock plays the
        same chips over a longer stretch of the motion.

        ValueError if the path as played leaves the frame, no chip was open, or the clock was so
        slow that the motion is not known for as long.
        """
        play = self.plays[0]
        chip_ns = self.program.chip_ns
        code = ShutterCode(play.achieved, chip_ns)
        exposures = 1 + play.scale_ppm * 1e-6
        if exposures > _MOST_EXPOSURES:
            raise ValueError(
                f"trajectory: is known for {_MOST_EXPOSURES:g} exposures at most, the code was"
                f" played for {exposures:g}"
            )
        edges = np.linspace(0, exposures, code.chips + 1)
        # openings that were longer than the fitted clock says count as closing late
        late_ns = min(max(play.widening_ns, 0.0), 0.9 * chip_ns)  # closing fits into a chip
        response = None
        if late_ns:
            response = ShutterResponse(chip_ns=chip_ns, on_bias_ns=late_ns)
        return played_psf(timeline(motion, edges, response, code=code), code, size)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep hw verify --json`` prints them."""
        return {"played": not self.wrong, "plays": [_figures(play) for play in self.plays]}

    def save(
        self,
        path: Path | str,
        *,
        motion: Trajectory | None = None,
        device: DeviceProfile | None = None,
        force: bool = False,
    ) -> Sequence[Path]:
        """Write the first play's code, and along a motion its PSF: all files or none.

        The code's file carries the profile of the shutter, where one is given.

        ValueError if a file exists and ``force`` is not given, or as of :attr:`code` and
        :meth:`psf`.
        """
        output = Path(path)
        play = self.plays[0]
        files = playback_files(output, with_psf=motion is not None)
        with new_folder(output.parent, [file.name for file in files], force=force) as folder:
            about = {"played": play.verdict, "device": device and device.to_dict()}
            write_code(folder / output.name, StoredCode(self.code, problem=about))
            if motion is not None:
                # A slow clock goes on beyond the motion that was asked for.
                size = max(PSF_PX, 2 * motion.frame_size())
                write_psf(folder, self.psf(motion, size=size), stem=_psf_stem(output))
        return files


def playback_files(path: Path | str, *, with_psf: bool) -> list[Path]:
    """List what :meth:`Playback.save` writes: the code, and with a motion its PSF beside it."""
    output = Path(path)
    psf_files = [output.with_name(_psf_stem(output) + suffix) for suffix in PSF_SUFFIXES]
    return [output, *(psf_files if with_psf else [])]


def read_playback(
    capture: Path | str,
    program: Program | ShutterCode,
    *,
    signal: str | None = None,
    trigger: str | None = None,
) -> Playback:
    """Read a recording of a shutter, and find the plays of a program in it.

    Parameters
    ----------
    capture : path
        VCD, or a CSV export of Saleae Logic.
    program : Program or ShutterCode
        That should have been played; a code with its chip time.
    signal : str, optional
        The shutter's; the busiest one when omitted.
    trigger : str, optional
        The trigger's: with it every play has its latency.

    Raises
    ------
    ValueError
        If the recording cannot be read or has no such signal, or nothing was played into it.

    Examples
    --------
    A recording of an ideal shutter, as the exporter writes it:

    >>> from tempfile import TemporaryDirectory
    >>> from hw.export import EXPORTERS
    >>> code = ShutterCode("110100100011", chip_ns=200_000)
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "played.vcd")
    ...     program = Program(code.bits, chip_ns=code.chip_ns)
    ...     _ = file.write_text(EXPORTERS["vcd"].export(program))
    ...     found = read_playback(file, code)
    >>> found.code == code, round(float(found.psf(Trajectory.straight(20.0)).sum()), 6)
    (True, 0.5)
    """
    if isinstance(program, ShutterCode):
        program = Program(program.bits, chip_ns=program.chip_ns)
    recording = read_recording(capture)
    trace = recording.trace(signal)
    trigger_trace = recording.trace(trigger) if trigger else None
    plays = align(trace, program, trigger=trigger_trace)
    playback = Playback(program, trace.name, plays)
    if signal is not None:  # the user has said which it is
        return playback
    # One that is much quieter is no rival, unless what was taken is wrong.
    min_edges = 1 if playback.wrong else len(trace.edges) // 2
    rivals = (
        rival
        for rival in recording.traces
        if rival not in (trace, trigger_trace) and len(rival.edges) >= max(min_edges, 1)
    )
    return replace(playback, rivals=tuple(rival.name for rival in rivals))


def _psf_stem(output: Path) -> str:
    return f"{output.stem}_psf"


def _figures(play: Verification) -> dict[str, object]:
    return {
        "bits": play.achieved,
        "same_bits": play.same_bits,
        "start_ns": play.start_ns,
        "clock_ppm": -play.scale_ppm,  # a fast clock plays shorter chips
        "jitter_ns": play.jitter_ns,
        "worst_ns": play.worst_ns,
        "widening_ns": play.widening_ns,
        "latency_ns": play.latency_ns,
        "missing": play.missing,
        "extra": play.extra,
        "glitches": play.glitches,
        "inverted": play.inverted,
        "verdict": play.verdict,
        "problems": play.problems,
    }
