"""Wiring of a camera and a shutter controller: pins, levels, least exposure, and its drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from cep.files.formatting import duration
from cep.optics.code import ShutterCode
from cep.plots.canvas import COLOURS, in_lines, new_figure
from cep.shutter.cameras import CAMERAS
from cep.shutter.exposure_plan import ExposurePlan, Release, ShotSettings, checked_release
from hw.cameras import camera_class

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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

_WIDTH_IN = 7.2
_ROW_IN = 0.95  # of a wire
_AROUND_IN = 1.6  # title and notes of a board
_BOARD = (0.02, 0.26)  # left and right sides of the boxes, of the width
_TARGET = (0.62, 0.98)
_SIZE_PT = 8.0

_INPUT = {
    "gphoto2": "the remote release's contact",
    "folder": "the camera's trigger input, or its remote release",
    "twin": "the emulated camera's trigger input: nothing is to be wired",
}
_OUTPUT = {
    "gphoto2": "flash sync (hot shoe); old flashes had 200 V there",
    "twin": "the emulated camera's exposure active: nothing is to be wired",
}
_SETTINGS = {
    Release.SHUTTER: "TriggerMode On, TriggerSource that line, ExposureMode Timed",
    Release.EXTERNAL: "TriggerMode On, TriggerSource that line, ExposureMode Timed",
    Release.CAMERA: "that output's LineSource ExposureActive, ExposureMode Timed",
    Release.HOST: "TriggerSource Software, ExposureMode Timed",
}
_ORDERS = {
    Release.SHUTTER: "this computer triggers the controller, its output busy the camera",
    Release.EXTERNAL: "the machine triggers the controller, its output busy the camera",
    Release.CAMERA: "this computer fires the camera, its exposure active triggers the controller",
    Release.HOST: "this computer fires the camera, and the controller a lead-in later",
}


@dataclass(frozen=True, kw_only=True)
class Wire:
    """A wire at a pin of the controller.

    Attributes
    ----------
    pin, signal : str
        Of the controller, as ``D9`` and ``shutter``.
    end : str
        Where it goes.
    between : str
        Part in the wire and its level, as ``optocoupler, 5 V``.
    is_input : bool
        Whether the signal comes to the controller.
    """

    pin: str
    signal: str
    end: str
    between: str
    is_input: bool = False


@dataclass(frozen=True, kw_only=True)
class WiredBoard:
    """A controller with its wires.

    Attributes
    ----------
    name : str
    order : str
        Who triggers whom.
    wires : tuple of Wire
    notes : tuple of str
        Resistors, the camera's settings, the least exposure.
    """

    name: str
    order: str
    wires: tuple[Wire, ...]
    notes: tuple[str, ...]


def wiring(
    kind: str,
    code: ShutterCode,
    *,
    firmware: str | None = None,
    settings: ShotSettings | None = None,
) -> tuple[WiredBoard, ...]:
    """Return how a camera, a controller and a strobe or shutter are wired, for each controller.

    Parameters
    ----------
    kind : str
        Of camera, as ``pylon``.
    firmware : str, optional
        Of the controller, as it reports it; both boards when omitted.
    settings : ShotSettings, optional
        Who begins, and the lead-in.

    Returns
    -------
    tuple of WiredBoard
        Empty where the frames are the shutter.

    Raises
    ------
    ValueError
        If there is no such kind of camera, or it cannot be released so.
    """
    settings = settings or ShotSettings()
    adapter = camera_class(kind, CAMERAS)
    if kind == "burst":
        return ()
    if kind == "twin":
        firmware = BOARDS[0].firmware  # the only one that is emulated
    boards = [board for board in BOARDS if (firmware or "").startswith(board.firmware)]
    boards = boards or list(BOARDS)
    wired: list[WiredBoard] = []
    for board in boards:
        try:
            release = checked_release(adapter.triggers, kind, board.firmware, settings.release)
        except ValueError:
            if board is boards[-1] and not wired:
                raise
            continue
        plan = ExposurePlan.of(code, settings, release, board_lead_ns=board.lead_ns)
        wired.append(_wired(board, kind, code, plan))
    return tuple(wired)


def wiring_lines(boards: Sequence[WiredBoard]) -> list[str]:
    """Say the wiring in lines."""
    if not boards:
        return ["A burst needs no wire and no controller: its frames are the shutter."]
    lines: list[str] = []
    for board in boards:
        lines.append(f"{board.name}: {board.order}")
        for wire in board.wires:
            arrow = "<--" if wire.is_input else "-->"
            lines.append(f"    {wire.pin:4} {wire.signal:8} {arrow} {wire.end} ({wire.between})")
        lines += [f"    {note}" for note in board.notes]
    return lines


def _wired(board: Board, kind: str, code: ShutterCode, plan: ExposurePlan) -> WiredBoard:
    release = plan.release
    notes = [f"10 kOhm from {board.shutter} to ground: closed while the controller starts"]
    wires = [
        Wire(
            pin=board.shutter,
            signal="shutter",
            end="strobe or shutter, by its driver",
            between=f"driver or optocoupler; high is open, {board.volts}",
        )
    ]
    triggers_camera = release in (Release.SHUTTER, Release.EXTERNAL)
    if triggers_camera and not board.busy:
        notes.append("no output busy: the camera is to be begun by hand, or by the machine")
    elif triggers_camera:
        wires.append(
            Wire(
                pin=board.busy,
                signal="busy",
                end=_INPUT.get(kind, "trigger input of the camera (Line1), its ground too"),
                between=f"optocoupler, the camera's own if it has one; {board.volts}",
            )
        )
    edge = f"rising edge, {board.volts} at most"
    triggers = {
        Release.EXTERNAL: (
            "light barrier or encoder of the machine",
            f"{edge}: an optocoupler behind 24 V",
        ),
        Release.CAMERA: (
            _OUTPUT.get(kind, "exposure active of the camera (Line2 or a GPIO line)"),
            f"optocoupler; {edge}",
        ),
    }
    if release in triggers:
        end, between = triggers[release]
        wires.append(
            Wire(pin=board.trigger, signal="trigger", end=end, between=between, is_input=True)
        )
    if release is Release.CAMERA:
        notes.append(
            f"an opto-coupled output only pulls down: 1 kOhm from {board.trigger} to"
            f" {board.volts}, and LineInverter so that it rises when the exposure begins"
        )
    if release is Release.HOST:
        notes.append("no wire to the camera: the lead-in must cover its delay, which varies")
    notes += [
        f"least exposure: {duration(plan.play_s, digits=4)}, of which the code takes"
        f" {duration(code.duration_ns * 1e-9, digits=4)} and the lead-in the rest; the camera"
        " must begin within the lead-in",
        f"camera: {_SETTINGS[release]}; cep shoot sets it where it can",
    ]
    return WiredBoard(
        name=f"{board.name} ({board.firmware})",
        order=_ORDERS[release],
        wires=tuple(wires),
        notes=tuple(notes),
    )


def wiring_figure(boards: Sequence[WiredBoard]) -> Figure:
    """Draw (N >= 1) controllers below each other, each with its wires and notes."""
    heights_in = [_ROW_IN * len(board.wires) + _AROUND_IN for board in boards]
    figure = new_figure(_WIDTH_IN, sum(heights_in))
    panels = figure.subplots(len(boards), 1, squeeze=False, height_ratios=heights_in)[:, 0]
    for axes, board, height_in in zip(panels, boards, heights_in, strict=True):
        _draw(axes, board, height_in)
    return figure


def _draw(axes: Axes, board: WiredBoard, height_in: float) -> None:
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(-height_in, 0)
    axes.text(0, 0, board.name, fontsize=_SIZE_PT + 2, fontweight="bold", va="top")
    text = partial(axes.text, fontsize=_SIZE_PT)
    text(0, -0.22, board.order, va="top")
    top_in = -0.45
    bottom_in = top_in - _ROW_IN * len(board.wires)
    _box(axes, _BOARD, top_in, bottom_in)
    for index, wire in enumerate(board.wires):
        middle_in = top_in - _ROW_IN * (index + 0.5)
        text(_BOARD[1] - 0.01, middle_in, f"{wire.signal}\n{wire.pin}", ha="right", va="center")
        _box(axes, _TARGET, middle_in + 0.36, middle_in - 0.36)
        target = in_lines(wire.end, (_TARGET[1] - _TARGET[0]) * _WIDTH_IN, _SIZE_PT)
        text(sum(_TARGET) / 2, middle_in, target, ha="center", va="center")
        edges = (_BOARD[1], _TARGET[0])
        start, end = reversed(edges) if wire.is_input else edges
        arrow = {
            "arrowstyle": "-|>",
            "color": COLOURS[1] if wire.is_input else COLOURS[0],
            "linewidth": 1.5,
            "shrinkA": 0,
            "shrinkB": 0,
        }
        axes.annotate("", (end, middle_in), (start, middle_in), arrowprops=arrow)
        between = in_lines(wire.between, (_TARGET[0] - _BOARD[1]) * _WIDTH_IN - 0.2, _SIZE_PT)
        text(sum(edges) / 2, middle_in + 0.05, between, ha="center", va="bottom")
    notes = "\n".join(in_lines(note, _WIDTH_IN, _SIZE_PT) for note in board.notes)
    text(0, bottom_in - 0.1, notes, va="top")


def _box(axes: Axes, sides: tuple[float, float], top_in: float, bottom_in: float) -> None:
    from matplotlib.patches import Rectangle

    size = (sides[1] - sides[0], top_in - bottom_in)
    axes.add_patch(
        Rectangle((sides[0], bottom_in), *size, facecolor="#f2f4f6", edgecolor="#57606a")
    )
