"""``cep hw verify``: what the controller holds, and what the shutter played, against what was asked for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import FAILURE, complain, finish, table
from cep.cli.options import ChipNs, CodeSource, Force, Json, Linear, TrajectoryFile, load_motion
from cep.cli.programs import ClockPpm, load_program, open_port, program_figures

if TYPE_CHECKING:
    from hw.program import Program
    from hw.recordings.playback import Verification

__all__ = ["verify"]


def verify(
    code: CodeSource,
    port: Annotated[str | None, typer.Option("--port", "-p", help="Read it back from the controller there.")] = None,
    capture: Annotated[
        Path | None,
        typer.Option(
            "--capture", "--vcd", help="Compare a logic analyser's recording: VCD, or a CSV export of Saleae Logic."
        ),
    ] = None,
    signal: Annotated[
        str | None, typer.Option("--signal", help="Shutter's signal in the recording; the busiest one without.")
    ] = None,
    trigger: Annotated[str | None, typer.Option("--trigger", help="Trigger's signal in the recording.")] = None,
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chip_ns: ChipNs = None,
    clock_ppm: ClockPpm = 0.0,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the code as played; beside it its PSF, with a trajectory."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare a code with what the controller holds (--port), or with what its shutter really played (--capture).

    A recording gives each play's chips, clock error and jitter, and with a motion the PSF as achieved, which cep deblur
    takes. Exit code 1 when anything differs.

    Example: cep hw verify code.json --capture capture.vcd --trajectory trajectory.json -o played.json
    """
    if (port is None) == (capture is None):
        raise ValueError("--port PORT or --capture FILE: exactly one of them is needed")
    with_capture = {
        "--signal": signal, "--trigger": trigger, "--trajectory": trajectory, "--linear": linear, "-o": output,
    }  # fmt: skip
    unused = [option for option, value in with_capture.items() if value is not None] if port is not None else []
    if unused:
        raise ValueError(f"{unused[0]}: not valid with --port, only with --capture")
    if capture is not None and clock_ppm:
        raise ValueError("--clock-ppm: not valid with --capture, only with --port")
    program, _ = load_program(code, chip_ns=chip_ns, device=None)
    if port is not None:
        _held(program, port, clock_ppm=clock_ppm, as_json=as_json)
        return
    assert capture is not None
    from cep.codes.sources import code_file
    from cep.io.outputs import claim, new_folder
    from hw.recordings.capture import read_capture
    from hw.recordings.playback import align

    motion = None if trajectory is None and linear is None else load_motion(trajectory, linear).trajectory
    written = _outputs(output, with_psf=motion is not None)
    claim(written, force=force, inputs=[file for file in (code_file(code), capture, trajectory) if file])
    recording = read_capture(capture)
    trace = recording.trace(signal)
    plays = align(trace, program, trigger=recording.trace(trigger) if trigger else None)
    if output is not None:
        with new_folder(output.parent, [path.name for path in written], force=force) as made:
            _write(made / output.name, plays[0], program, motion)
    wrong = [(index, play) for index, play in enumerate(plays, start=1) if play.problems or not play.same_bits]
    result = {
        "file": capture, "signal": trace.name, **program_figures(program, None), "played": not wrong,
        "plays": [_figures(play) for play in plays], "files": written,
    }  # fmt: skip
    finish(result, as_json=as_json, show=lambda console: console.print(
        table(f"{capture}, {trace.name}", ("play", "clock, ppm", "jitter, ns", "worst edge, ns", "same bits"), [
            (f"{index} at {play.start_ns / 1e6:.4f} ms", -play.scale_ppm, play.jitter_ns, play.worst_ns,
             "yes" if play.same_bits else "no") for index, play in enumerate(plays, start=1)
        ])
    ))  # fmt: skip
    if wrong:
        index, play = wrong[0]
        others = f" ({len(wrong)} of {len(plays)} plays differ)" if len(plays) > 1 else ""
        complain(f"play {index}: {play.verdict}{others}")
        raise typer.Exit(FAILURE)


def _held(program: Program, port: str, *, clock_ppm: float, as_json: bool) -> None:
    from hw.drivers.cxp import PROVEN_FIRMWARE
    from hw.drivers.report import Trust

    with open_port(port) as controller:
        controller.verify(program, clock_ppm=clock_ppm)
        firmware = controller.announced.firmware
    trust = Trust.A if firmware in PROVEN_FIRMWARE else Trust.B
    result = {
        "port": port, "firmware": firmware, **program_figures(program, None), "read_back": True, "trust": trust.value,
    }  # fmt: skip
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{port}: holds this code, {program.chips} chips of {program.chip_ns} ns, bit for bit, trust {trust}"
    ))  # fmt: skip


def _psf_stem(output: Path) -> str:
    return f"{output.stem}_psf"


def _outputs(output: Path | None, *, with_psf: bool) -> list[Path]:
    from cep.io.files import PSF_SUFFIXES

    if output is None:
        return []
    beside = [output.with_name(_psf_stem(output) + suffix) for suffix in PSF_SUFFIXES] if with_psf else []
    return [output, *beside]


def _write(output: Path, play: Verification, program: Program, motion: Any) -> None:
    from cep.io.files import StoredCode, write_code, write_psf
    from cep.optics.as_played import achieved_code, achieved_psf
    from motdiff.psf_frame import PSF_PX

    code = achieved_code(play, chip_ns=program.chip_ns)
    write_code(output, StoredCode(code, problem={"played": play.verdict}))
    if motion is not None:
        size = max(PSF_PX, 2 * motion.frame_size())  # a slow clock goes on beyond the motion that was asked for
        psf = achieved_psf(motion, play, chip_ns=program.chip_ns, size=size)
        write_psf(output.parent, psf, stem=_psf_stem(output))


def _figures(play: Verification) -> dict[str, object]:
    return {
        "bits": play.achieved, "same_bits": play.same_bits, "start_ns": play.start_ns, "clock_ppm": -play.scale_ppm,
        "jitter_ns": play.jitter_ns, "worst_ns": play.worst_ns, "widening_ns": play.widening_ns,
        "latency_ns": play.latency_ns, "missing": play.missing, "extra": play.extra, "inverted": play.inverted,
        "verdict": play.verdict, "problems": play.problems,
    }  # fmt: skip
