"""Wiring of cameras and controllers: pins, limits, and drawings that stay readable."""

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.shutter.cameras import CAMERAS
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.wiring import Wire, WiredBoard, wiring, wiring_figure, wiring_lines

CODE = ShutterCode("1011001110100110", 400_000)
BY_SHUTTER = ShotSettings(release=Release.SHUTTER)


def test_wiring_names_pins_and_the_least_exposure():
    lines = wiring_lines(wiring("twin", CODE))
    assert any("D9" in line for line in lines)
    assert any("A1" in line for line in lines)
    # 20 us of the firmware, three chips of lead-in, sixteen of the code
    assert any("least exposure: 7.62 ms" in line for line in lines)


def test_a_pico_has_no_busy_output():
    with pytest.raises(ValueError, match='no output "busy"'):
        wiring("pylon", CODE, firmware="cxp-rp2040 1", settings=BY_SHUTTER)
    lines = wiring_lines(wiring("pylon", CODE, firmware="cxp-rp2040 1"))
    assert any("GP14" in line and "exposure active" in line for line in lines)


@pytest.mark.parametrize("kind", [*CAMERAS])
@pytest.mark.parametrize("release", [None, *Release])
def test_every_wiring_that_can_be_is_drawn_and_no_text_leaves_the_picture(kind, release):
    try:
        boards = wiring(kind, CODE, settings=ShotSettings(release=release))
    except ValueError:
        pytest.skip("this camera cannot be released so")
    if not boards:
        assert kind == "burst"
        return
    figure = wiring_figure(boards)
    figure.draw_without_rendering()
    width, height = figure.get_size_inches() * figure.dpi
    for axes, board in zip(figure.axes, boards, strict=True):
        words = " ".join(text.get_text() for text in axes.texts)
        assert all(wire.pin in words for wire in board.wires)
        for text in axes.texts:
            extent = text.get_window_extent()
            assert extent.x0 >= 0
            assert extent.x1 <= width
            assert extent.y0 >= 0
            assert extent.y1 <= height


def test_a_wire_takes_as_much_room_on_every_board():
    counts = (2, 6)
    boards = [
        WiredBoard(
            name=f"board of {count} wires",
            order="the shutter triggers the camera",
            wires=tuple(
                Wire(pin=f"D{pin}", signal="shutter", end="the driver", between="5 V")
                for pin in range(count)
            ),
            notes=("least exposure: 7.62 ms",),
        )
        for count in counts
    ]
    figure = wiring_figure(boards)
    figure.draw_without_rendering()
    heights_in = []
    for axes, count in zip(figure.axes, counts, strict=True):
        boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
        assert not any(box.overlaps(other) for i, box in enumerate(boxes) for other in boxes[:i])
        pins = [text for text in axes.texts if text.get_text().startswith("shutter\nD")]
        tops = [pin.get_window_extent().y1 / figure.dpi for pin in pins]
        assert len(tops) == count
        heights_in += (-np.diff(tops)).tolist()
    assert min(heights_in) > 0.5
    np.testing.assert_allclose(heights_in, heights_in[0], rtol=0.01)


def test_texts_of_a_wire_are_broken_where_their_room_ends():
    end = "gate of the transistor that switches the light's supply, and its ground"
    between = "a resistor of 1 kOhm in the wire and one of 10 kOhm from it to ground"
    wire = Wire(pin="D9", signal="shutter", end=end, between=between)
    figure = wiring_figure([WiredBoard(name="Uno", order="alone", wires=(wire,), notes=())])
    figure.draw_without_rendering()
    (axes,) = figure.axes
    board, target = sorted(
        (box.get_window_extent() for box in axes.patches), key=lambda box: box.x0
    )
    texts = {" ".join(text.get_text().split()): text for text in axes.texts}
    pin, goal, part = (texts[words] for words in ("shutter D9", end, between))
    for text, room in ((pin, board), (goal, target)):
        extent = text.get_window_extent()
        assert room.x0 < extent.x0 < extent.x1 < room.x1
        assert room.y0 < extent.y0 < extent.y1 < room.y1
    extent = part.get_window_extent()
    assert board.x1 < extent.x0 < extent.x1 < target.x0
    # and not before: most of the room's width is used
    assert goal.get_window_extent().width > 0.5 * target.width
    assert extent.width > 0.5 * (target.x0 - board.x1)
