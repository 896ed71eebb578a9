"""Drawing of the wires between a shutter's controller, the shutter and a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cep.plots.canvas import COLOURS, in_lines, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN = 7.2
_ROW_IN = 0.95  # of a wire
_AROUND_IN = 1.6  # title and notes of a board
_BOARD = (0.02, 0.26)  # left and right sides of the boxes, of the width
_TARGET = (0.62, 0.98)
_SIZE_PT = 8.0


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
    axes.text(0, -0.22, board.order, fontsize=_SIZE_PT, va="top")
    top_in = -0.45
    bottom_in = top_in - _ROW_IN * len(board.wires)
    _box(axes, _BOARD, top_in, bottom_in)
    for index, wire in enumerate(board.wires):
        middle_in = top_in - _ROW_IN * (index + 0.5)
        axes.text(
            _BOARD[1] - 0.01,
            middle_in,
            f"{wire.signal}\n{wire.pin}",
            fontsize=_SIZE_PT,
            ha="right",
            va="center",
        )
        _box(axes, _TARGET, middle_in + 0.36, middle_in - 0.36)
        box_in = (_TARGET[1] - _TARGET[0]) * _WIDTH_IN
        axes.text(
            sum(_TARGET) / 2,
            middle_in,
            in_lines(wire.end, box_in, _SIZE_PT),
            fontsize=_SIZE_PT,
            ha="center",
            va="center",
        )
        edges = (_BOARD[1], _TARGET[0])
        start, end = reversed(edges) if wire.is_input else edges
        axes.annotate(
            "",
            (end, middle_in),
            (start, middle_in),
            arrowprops={
                "arrowstyle": "-|>",
                "color": COLOURS[1] if wire.is_input else COLOURS[0],
                "linewidth": 1.5,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
        axes.text(
            (_BOARD[1] + _TARGET[0]) / 2,
            middle_in + 0.05,
            in_lines(wire.between, (_TARGET[0] - _BOARD[1]) * _WIDTH_IN - 0.2, _SIZE_PT),
            fontsize=_SIZE_PT,
            ha="center",
            va="bottom",
        )
    notes = "\n".join(in_lines(note, _WIDTH_IN, _SIZE_PT) for note in board.notes)
    axes.text(0, bottom_in - 0.1, notes, fontsize=_SIZE_PT, va="top")


def _box(axes: Axes, sides: tuple[float, float], top_in: float, bottom_in: float) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(
        Rectangle(
            (sides[0], bottom_in),
            sides[1] - sides[0],
            top_in - bottom_in,
            facecolor="#f2f4f6",
            edgecolor="#57606a",
        )
    )
