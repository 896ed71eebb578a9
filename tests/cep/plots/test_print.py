"""Figures in print: text is text, its font is in the file, and none is below 7 pt on a page."""

import re
import zlib

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.frame_pairs import CodeRange, FramePair
from cep.optics.photon_transfer import photon_transfer
from cep.plots.advice import advice_figure
from cep.plots.camera import photon_transfer_figure
from cep.plots.canvas import PRINTED_IN, in_lines, least_pt, save
from cep.plots.codes import code_strips, mtf_figure
from cep.plots.photos import trajectory_figure
from cep.search.advise import advise
from cep.search.problem import SearchProblem
from lab.bench.blind.picture import Shown, blind_figure
from lab.fronts.plot import pareto_figure
from lab.fronts.search import pareto_front
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [8, 2], [9, 9]], direction="known")
CODE = ShutterCode("1101")


def mtfs(count):
    return lambda: mtf_figure(
        PATH, dict.fromkeys((f"code {index}" for index in range(count)), CODE), grid=9
    )


def advised():
    problem = SearchProblem.along(Trajectory.straight(6.0), chips=6, camera=Camera(read_noise_e=5))
    return advice_figure(advise(problem, seed=0))


def front():
    return pareto_figure(
        pareto_front(
            SearchProblem(chips=8, open_range=(3, 5)), rng=np.random.default_rng(0), steps=500
        )
    )


def curve():
    rng = np.random.default_rng(0)

    def frame(level):
        values = 64 + (rng.poisson(level, (200, 200)) + rng.normal(0, 8, (200, 200))) / 2.5
        return np.clip(np.rint(values), 0, 4095).astype(np.uint16)

    pairs = [FramePair.of(frame(level), frame(level)) for level in (500, 2000, 5000)]
    return photon_transfer_figure(
        photon_transfer(pairs, codes=CodeRange(12), dark=FramePair.of(frame(0), frame(0)))
    )


def blind(methods):
    psf = PATH.psf(33)
    photo = np.full((40, 40), 0.5)
    names = [f"method-{index}" for index in range(methods)]
    line = Shown(
        photo,
        photo,
        psf,
        dict.fromkeys(names, psf),
        dict.fromkeys(names, "MNC 0.82, 27.5 dB"),
        "srgb",
    )
    return lambda: blind_figure([line], names)


FIGURES = {
    "mtf of 1": mtfs(1),
    "mtf of 3": mtfs(3),
    "mtf of 7": mtfs(7),
    "advice": advised,
    "front": front,
    "camera": curve,
    "strips": lambda: code_strips({"a": CODE, "b": CODE}),
    "blind of 2": blind(2),
    "blind of 6": blind(6),
    "blind of 9": blind(9),
    "path": lambda: trajectory_figure(np.full((40, 60), 0.2), PATH),
}


def texts(figure):
    from matplotlib.text import Text

    figure.draw_without_rendering()
    return [
        text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()
    ]


@pytest.mark.parametrize("name", FIGURES)
def test_no_text_is_below_7_pt_on_a_page(name):
    figure = FIGURES[name]()
    shrunk = min(1.0, PRINTED_IN / figure.get_figwidth())
    sizes = {text.get_text(): text.get_fontsize() * shrunk for text in texts(figure)}
    assert sizes
    assert {text: size for text, size in sizes.items() if size < 7 - 1e-9} == {}
    assert not [text for text in sizes if "^" in text], "an exponent is smaller than its text"


@pytest.mark.parametrize("name", ["mtf of 7", "blind of 2", "blind of 6", "blind of 9", "advice"])
def test_texts_lie_within_the_figure_and_titles_apart(name):
    figure = FIGURES[name]()
    texts(figure)
    for axes in figure.axes:
        box = axes.title.get_window_extent()
        assert figure.bbox.x0 - 1 <= box.x0
        assert box.x1 <= figure.bbox.x1 + 1
    shown = [
        one
        for axes in figure.axes
        for one in (axes.title, axes.xaxis.label)
        if one.get_text() and axes.axison
    ]
    boxes = [one.get_window_extent() for one in shown]
    assert not any(
        one.overlaps(other) for place, one in enumerate(boxes) for other in boxes[:place]
    )


def test_svg_has_its_words_as_text(tmp_path):
    save(mtfs(2)(), tmp_path / "mtf.svg")
    svg = (tmp_path / "mtf.svg").read_text(encoding="utf-8")
    written = re.findall(r"<text[^>]*>([^<]*)</text>", svg)
    assert {"MTF, light-true", "code 0", "code 1"} <= set(written)
    assert "<dc:date>" not in svg


def test_pdf_has_its_font_within_and_its_words_as_text(tmp_path):
    save(mtfs(2)(), tmp_path / "mtf.pdf")
    data = (tmp_path / "mtf.pdf").read_bytes()
    assert b"/FontFile2" in data, "TrueType, embedded"
    assert b"/Type3" not in data
    width_pt = float(re.search(rb"/MediaBox \[ ?0 0 ([\d.]+)", data)[1])
    assert width_pt == pytest.approx(7.5 * 72)
    streams = [
        zlib.decompress(part)
        for part in re.findall(rb"/FlateDecode.*?stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
        if part[:1] == b"x"
    ]
    assert any(b"Tj" in stream or b"TJ" in stream for stream in streams)


def test_wide_figures_have_larger_texts():
    assert least_pt(3.0) == least_pt(PRINTED_IN) == 7.0
    assert least_pt(2 * PRINTED_IN) == 14.0
    assert in_lines("DNF (length known, direction ignored)", 1.0, 7.0).count("\n") == 3
