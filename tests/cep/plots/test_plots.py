"""Figures show what they say: data, units, directions; and they leave no global state behind."""

import subprocess
import sys

import cv2
import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.plots.advice import advice_figure
from cep.plots.canvas import COLOURS, png_bytes, save, thumbnail
from cep.plots.codes import code_strips, mtf_figure
from cep.plots.photos import before_after, psf_figure, trajectory_figure
from cep.search.advise import Advice, advise
from cep.search.problem import SearchProblem
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

NAMES = ("start", "end", "one end", "other end")
BENT = Trajectory.from_samples([[0, 0], [8, 2], [9, 9]], direction="known")


def pixels(figure):
    return cv2.imdecode(np.frombuffer(png_bytes(figure, dpi=60), np.uint8), cv2.IMREAD_COLOR)


def test_a_path_is_drawn_as_the_photo_lies():
    """The y axis runs down, and each end of a known direction has its name."""
    figure = trajectory_figure(np.full((40, 60), 0.2), BENT)
    path = figure.axes[1]
    assert path.get_ylim()[0] > path.get_ylim()[1]
    assert path.get_xlim()[0] < path.get_xlim()[1]
    ends = {
        drawn.get_label(): drawn.get_offsets()[0]
        for drawn in path.collections
        if drawn.get_label() in NAMES
    }
    np.testing.assert_allclose(ends["start"], BENT.xy[0])
    np.testing.assert_allclose(ends["end"], BENT.xy[-1])
    assert [text.get_text() for text in path.get_legend().get_texts()] == ["start", "end"]


def test_an_unknown_direction_has_no_start():
    unknown = Trajectory.from_samples(BENT.xy)
    legend = trajectory_figure(np.zeros((40, 60)), unknown).axes[1].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["one end", "other end"]


def closed():
    angle = np.linspace(0, 2 * np.pi, 80)
    return Trajectory.from_samples(
        8 * np.stack([np.cos(angle), np.sin(2 * angle) / 2], 1), direction="known"
    )


@pytest.mark.parametrize(
    "path",
    [
        Trajectory.straight(20.0),
        Trajectory.straight(0.0),
        closed(),
        boracchi_foi(np.random.default_rng(8)),
    ],
    ids=["straight", "still", "closed", "tangle"],
)
def test_the_names_of_both_ends_can_be_read_wherever_the_ends_are(path):
    """Neither lies over the other, over the path or over the scale of time; and both ends are
    there to be seen."""
    figure = trajectory_figure(np.full((40, 60), 0.5), path)
    image = cv2.cvtColor(pixels(figure), cv2.COLOR_BGR2RGB)  # places the texts, too
    figure.canvas.draw()
    panel, scale = figure.axes[1:]
    legend = panel.get_legend()
    words = [text for text in (*panel.texts, *legend.get_texts()) if text.get_text() in NAMES]
    first, second = (text.get_window_extent() for text in words)
    assert not first.overlaps(second)
    for box in (first, second):
        assert not box.overlaps(panel.bbox)
        assert not box.overlaps(scale.bbox)
        assert not box.overlaps(panel.title.get_window_extent())
        assert figure.bbox.contains(*box.min)
        assert figure.bbox.contains(*box.max)
    left, bottom, right, top = (panel.bbox.extents * 60 / figure.dpi).astype(int)
    inside = image[len(image) - top : len(image) - bottom, left:right].astype(int)
    for colour in (COLOURS[1], COLOURS[2]):
        wanted = [int(colour[place : place + 2], 16) for place in (1, 3, 5)]
        assert (np.abs(inside - wanted).max(axis=2) < 40).sum() >= 10


def test_axes_have_units():
    figures = [
        trajectory_figure(np.zeros((40, 60, 3)), BENT),
        psf_figure({"a": BENT.psf(32), "b": BENT.psf(32)}),
        mtf_figure(BENT, {"open": None, "code": ShutterCode("1101")}, grid=17),
        code_strips({"a": ShutterCode("1101", 500_000)}),
    ]
    for figure in figures:
        labels = [axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes if axes.axison]
        assert any("px" in label or "500 us" in label for label in labels)


def test_the_map_of_a_code_is_its_mtf():
    figure = mtf_figure(BENT, {"open": None}, grid=17)
    shown = figure.axes[1].images[0].get_array()
    line = np.linspace(-0.5, 0.5, 17)
    fx, fy = np.meshgrid(line, line)
    np.testing.assert_allclose(
        shown, 20 * np.log10(np.maximum(np.abs(BENT.otf(fx, fy)), 1e-6)), atol=1e-6
    )


def test_strips_show_the_bits():
    codes = {"a": ShutterCode("110100"), "b": ShutterCode("000111")}
    figure = code_strips(codes)
    for axes, code in zip(figure.axes, codes.values(), strict=True):
        np.testing.assert_array_equal(axes.images[0].get_array()[0], code.array)


def test_before_and_after_share_one_detail():
    rng = np.random.default_rng(0)
    busy = np.full((200, 220), 0.5)
    busy[120:160, 60:100] = rng.random((40, 40))
    figure = before_after({"a": np.zeros((200, 220)), "b": busy}, zoom_px=40)
    top = figure.axes[1]
    bottom = figure.axes[3]
    assert bottom.images[0].get_array().shape[:2] == (40, 40)
    assert np.std(bottom.images[0].get_array()) > 0.1
    corner = top.patches[0].get_xy()
    assert abs(corner[0] - 60) <= 10
    assert abs(corner[1] - 120) <= 10


def test_another_photo_may_choose_the_detail():
    rng = np.random.default_rng(0)
    busy = np.full((200, 220), 0.5)
    busy[120:160, 60:100] = rng.random((40, 40))
    figure = before_after(
        {"a": np.zeros((200, 220)), "b": np.zeros((200, 220))}, zoom_px=40, detail_of=busy
    )
    corner = figure.axes[1].patches[0].get_xy()
    assert abs(corner[0] - 60) <= 10
    assert abs(corner[1] - 120) <= 10


@pytest.mark.parametrize("shape", [(16, 16), (20, 300), (300, 20, 3)])
def test_any_photo_can_be_drawn(shape):
    photo = np.random.default_rng(0).random(shape)
    assert pixels(trajectory_figure(photo, BENT)).size
    assert pixels(before_after({"a": photo, "b": photo})).size


def test_the_same_figure_gives_the_same_bytes():
    first, second = (png_bytes(code_strips({"a": ShutterCode("1101")})) for _ in range(2))
    assert first == second


def test_files_by_suffix(tmp_path):
    figure = code_strips({"a": ShutterCode("1101")})
    for name, magic in (("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.svg", b"<?xml")):
        save(figure, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)
        written = (tmp_path / name).read_bytes()
        assert b"CreationDate" not in written  # the same figure is the same file tomorrow
        assert b"dc:date" not in written
    with pytest.raises(ValueError, match=r"\.png, \.pdf or \.svg"):
        save(figure, tmp_path / "a.gif")
    assert len(list(tmp_path.iterdir())) == 3


def test_pyplot_is_never_loaded():
    code = (
        "import sys, numpy as np; from cep.plots.canvas import *; from cep.plots.codes import"
        " *; from cep.plots.photos import *; from cep.optics.code import ShutterCode\nfrom"
        " motdiff.trajectory import Trajectory\nt = Trajectory.straight(5.0);"
        " png_bytes(trajectory_figure(np.zeros((20, 20)), t))\npsf_figure({'a': t.psf(16)});"
        " code_strips({'a': ShutterCode('11')}); mtf_figure(t, {'a': None}, grid=9)\nassert"
        " 'matplotlib.figure' in sys.modules and 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_where_the_advice_turns_is_shaded_to_the_end_of_the_levels(monkeypatch):
    problem = SearchProblem.along(Trajectory.straight(6.0), chips=6, camera=Camera(read_noise_e=5))
    monkeypatch.setattr(Advice, "crossover", ((2000.0, 3000.0), (None, 1500.0), (8000.0, None)))
    figure = advice_figure(advise(problem, levels=[1000.0, 10_000.0]))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    to_data = axes.transData.inverted()
    spans = [patch.get_window_extent().transformed(to_data).intervalx for patch in axes.patches]
    assert np.ravel(spans) == pytest.approx([2000, 3000, 1000, 1500, 8000, 10_000])


@pytest.mark.parametrize(
    ("open_range", "names"),
    [((1, 6), {"best single exposure", "best code"}), ((6, 6), set())],
    ids=["any code", "open alone"],
)
def test_gains_over_the_light_name_the_ways_that_the_limits_leave(open_range, names):
    problem = SearchProblem.along(
        Trajectory.straight(6.0), chips=6, camera=Camera(read_noise_e=5), open_range=open_range
    )
    (axes,) = advice_figure(advise(problem, levels=[1000.0, 10_000.0])).axes
    legend = axes.get_legend()
    assert names == ({text.get_text() for text in legend.get_texts()} if legend else set())


def test_a_thumbnail_is_of_whole_boxes_as_bright_as_they_are():
    image = np.random.default_rng(2).uniform(size=(7, 9, 3))
    small = thumbnail(image, 3)
    assert small.shape == (2, 3, 3)
    np.testing.assert_allclose(small[1, 2], image[3:6, 6:9].mean(axis=(0, 1)))
    np.testing.assert_array_equal(thumbnail(image, 9), image)
