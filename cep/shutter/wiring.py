"""Wiring of a camera and a shutter controller: which pin goes where, levels, least exposure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cep.files.formatting import duration
from cep.optics.code import ShutterCode
from cep.shutter.cameras import CAMERAS
from cep.shutter.shoot import LEAD_IN_S, Release, checked_release
from hw.cameras import camera_class

_TRIGGERS_CAMERA = (Release.SHUTTER, Release.EXTERNAL)


@dataclass(frozen=True)
class Board:
    """Pins of a controller."""

    name: str
    firmware: str
    shutter: str
    trigger: str
    busy: str
    volts: str
    lead_ns: int


BOARDS = (
    Board("Arduino Uno or Nano", "cxp-avr", "D9", "D2", "A1", "5 V", 20_000),
    Board("Raspberry Pi Pico", "cxp-rp2040", "GP15", "GP14", "", "3.3 V", 32),
)
"""Controllers with this project's firmware."""

_INPUT = {
    "gphoto2": "the remote release's contact, through an optocoupler",
    "folder": "the camera's trigger input, or its remote release, through an optocoupler",
    "twin": "the emulated camera's trigger input: nothing is to be wired",
}
_OUTPUT = {
    "gphoto2": "flash sync (hot shoe): an optocoupler between, old flashes had 200 V there",
    "twin": "the emulated camera's exposure active: nothing is to be wired",
}
_SETTINGS = {
    Release.SHUTTER: "TriggerMode On, TriggerSource that line, ExposureMode Timed",
    Release.EXTERNAL: "TriggerMode On, TriggerSource that line, ExposureMode Timed",
    Release.CAMERA: "that output's LineSource ExposureActive, ExposureMode Timed",
    Release.HOST: "TriggerSource Software, ExposureMode Timed",
}


def wiring(
    kind: str,
    code: ShutterCode,
    *,
    firmware: str | None = None,
    release: Release | None = None,
    lead_in_s: float = LEAD_IN_S,
) -> tuple[str, ...]:
    """Say in lines how a camera, a controller and a strobe or shutter are wired.

    Parameters
    ----------
    kind : str
        Of camera, as ``pylon``.
    code : ShutterCode
    firmware : str, optional
        Of the controller, as it reports it; both boards when omitted.
    release : Release, optional
        Who begins; as :func:`cep.shutter.shoot.shoot` chooses it when omitted.
    lead_in_s : float

    Raises
    ------
    ValueError
        If there is no such kind of camera, or it cannot be released so.
    """
    adapter = camera_class(kind, CAMERAS)
    if kind == "burst":
        return ("A burst needs no wire and no controller: its frames are the shutter.",)
    if kind == "twin":
        firmware = BOARDS[0].firmware  # the only one that is emulated
    boards = [board for board in BOARDS if (firmware or "").startswith(board.firmware)]
    boards = boards or list(BOARDS)
    lines: list[str] = []
    for board in boards:
        try:
            chosen = checked_release(adapter.triggers, kind, board.firmware, release)
        except ValueError:
            if len(boards) == 1 or (board is boards[-1] and not lines):
                raise
            continue
        lines += _board_lines(board, kind, chosen)
        closed_ns = math.ceil(lead_in_s * 1e9 / code.chip_ns) * code.chip_ns
        least_s = 1e-9 * (board.lead_ns + closed_ns + code.duration_ns)
        lines += [
            f"    least exposure: {duration(least_s, digits=4)}, of which the code takes"
            f" {duration(code.duration_ns * 1e-9, digits=4)} and the lead-in the rest; the camera"
            " must begin within the lead-in",
            f"    camera: {_SETTINGS[chosen]}; cep shoot sets it where it can",
        ]
    return tuple(lines)


def _board_lines(board: Board, kind: str, release: Release) -> list[str]:
    lines = [
        f"{board.name} ({board.firmware}), triggered by: {release}",
        f"    {board.shutter:4} shutter  --> driver or optocoupler --> strobe or shutter;"
        f" high is open, {board.volts}; 10 kOhm from {board.shutter} to ground",
    ]
    if release in _TRIGGERS_CAMERA:
        target = _INPUT.get(
            kind, "trigger input of the camera (Line1, opto-coupled; its ground too)"
        )
        lines.append(f"    {board.busy or '(no busy)':4} busy     --> {target}")
    if release is Release.EXTERNAL:
        lines.append(
            f"    {board.trigger:4} trigger  <-- light barrier or encoder, rising edge,"
            f" {board.volts} at most: an optocoupler between a 24 V output and it"
        )
    if release is Release.CAMERA:
        source = _OUTPUT.get(kind, "exposure active output of the camera (Line2 or a GPIO line)")
        lines += [
            f"    {board.trigger:4} trigger  <-- {source}, rising edge, {board.volts} at most",
            f"    an opto-coupled output only pulls down: 1 kOhm from {board.trigger} to"
            f" {board.volts}, and LineInverter so that it rises when the exposure begins",
        ]
    if release is Release.HOST:
        lines.append("    no wire to the camera: the lead-in must cover its delay, which varies")
    return lines
