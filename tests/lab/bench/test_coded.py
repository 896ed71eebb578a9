"""The coded-exposure table: its protocols, who is told what, the photos taken, and what is summed
up."""

import csv
import io
import sys
import tomllib
from dataclasses import asdict, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from cep.codes.published import DCE_CODE, published
from cep.files.images import write_image
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.proofs.measure import measure
from cep.restoration.wiener import wiener
from cep.search import recipe
from lab.bench.coded import protocol, run
from lab.bench.coded.calibrations import (
    CALIBRATIONS,
    POINT,
    calibration_photos,
    codes_of_set,
    motion_from_light,
    moved_psfs,
)
from lab.bench.coded.designs import DESIGNS, USUAL_DESIGNS, MotionPrior, design_code
from lab.bench.coded.protocol import (
    CodedProtocol,
    class_motions,
    coded_protocol,
    drawn_motions,
    paths_from,
    paths_to,
)
from lab.bench.coded.report import coded_report
from lab.bench.coded.run import (
    ESTIMATORS,
    CodedTable,
    Shot,
    code_version,
    measure_coded,
    motion_version,
    photo_version,
)
from lab.bench.coded.stages import estimate_motion, photographed, pictures_of, take_photo
from lab.bench.coded.tables import coded_tables, harmed, shots_csv
from lab.bench.datasets import sharp_scene
from lab.bench.harness import TABLE_ENDINGS
from lab.bench.psf_text import psf_to_text
from lab.bench.table_io import Provenance
from lab.jobs.engine import Engine, Outcome
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.estimator import CodedEstimator
from motdiff.estimators.coded.trail_estimator import TrailEstimator
from motdiff.metrics import timed_distance_px
from motdiff.motions import boracchi_foi
from motdiff.psf_frame import PSF_PX, centroid_px, moved
from motdiff.simulate import visible
from motdiff.tracing.quadratic import nearest_quadratic
from motdiff.trajectory import Trajectory

MADE = Provenance("again", 0, [], [])

TINY = CodedProtocol(
    name="tiny",
    photos=1,
    motions=2,
    crop_px=96,
    borders="symmetric",
    shakes="mixed",
    chips=16,
    open_range=(6, 10),
    objective="noise",
    photons=(),
    calibration_photons=1e4,
    bits=12,
    read_noise_e=0.0,
    restoration="inverse",
    border_rounds=10,
    restored_by="psf",
    steps=2000,
    seed=0,
    quick_photos=1,
    quick_motions=1,
    quick_steps=1000,
    quick_photons=(),
)
CLEAN = Camera(photons_full_scale=1e9, read_noise_e=0.0, bits=16).to_dict()
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11], [7, 16]])
LOPSIDED = "1101000101101111"


def blocks(side, seed=0):
    """Make a scene with edges in all places and much light and shade."""
    rng = np.random.default_rng(seed)
    return (
        0.05
        + 0.9 * np.kron(rng.random((side // 8 + 1, side // 8 + 1)), np.ones((8, 8)))[:side, :side]
    )


def shown(
    motion,
    *,
    assumed=None,
    bits=LOPSIDED,
    borders="symmetric",
    light_true=True,
    camera=CLEAN,
    side=128,
    **other,
):
    return {
        "scene": blocks(side),
        "motion": paths_to([motion], [1.0]),
        "assumed": assumed and paths_to([assumed], [1.0]),
        "bits": bits,
        "borders": borders,
        "light_true": light_true,
        "restoration": "wiener",
        "border_rounds": 10,
        "camera": camera,
        "seed": 0,
        **other,
    }


# -- protocols ------------------------------------------------------------------------------------


def test_the_papers_protocol_is_the_papers():
    """arXiv 2510.26173, section IV: 10 photos x 100 motions, 256-px crops, mirrored borders,
    inverse filter."""
    paper = coded_protocol("paper")
    assert (paper.photos, paper.motions, paper.crop_px, paper.borders) == (
        10,
        100,
        256,
        "symmetric",
    )
    assert (paper.levels, paper.restoration, paper.restored_by) == ((None,), "inverse", "psf")
    assert paper.calibration_camera == paper.camera(None)
    assert paper.camera(None).noise_variance(0.5) == pytest.approx((1 / 255) ** 2 / 12, rel=1e-3)
    assert paper.quick == replace(paper, photos=2, motions=2, steps=paper.quick_steps)
    ours = coded_protocol("ours")
    assert (ours.quick.photons, paper.quick.photons) == ((1000.0, 10000.0), ())


def test_ours_has_five_light_levels_and_hides_the_motion():
    ours = coded_protocol("ours")
    assert (ours.borders, len(ours.levels), ours.restored_by) == ("real", 5, "path")
    assert ours.calibration_camera.photons_full_scale == ours.calibration_photons in ours.levels
    for level in ours.levels:
        camera = ours.camera(level)
        assert (camera.photons_full_scale, camera.read_noise_e) == (level, 5.0)
        assert camera.black_level >= 5 * camera.read_noise_e / level


def written(path, **changes):
    entries = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in asdict(TINY).items()
    } | changes
    lines = (
        f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}"
        for key, value in entries.items()
    )
    path.write_text("\n".join(line for line in lines if not line.endswith("None")) + "\n")
    return str(path)


def test_a_protocol_of_ones_own_is_a_file(tmp_path):
    assert coded_protocol(written(tmp_path / "mine.toml")) == TINY
    levels = coded_protocol(written(tmp_path / "mine.toml", photons=[100, 2000.0])).levels
    assert levels == (100.0, 2000.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"photos": 0}, "photos: must be a whole number within 1..10000, got 0"),
        ({"motions": True}, "motions: must be a whole number"),
        ({"crop_px": 64}, "crop_px: must be a whole number within 80.."),
        ({"bits": 17}, "bits: must be a whole number within 1..16"),
        ({"steps": 1e5}, "steps: must be a whole number"),
        ({"seed": -1}, "seed: must be a whole number"),
        ({"borders": "open"}, "borders: must be one of real, symmetric, got 'open'"),
        ({"shakes": "hard"}, "shakes: must be one of"),
        ({"objective": "psnr"}, "objective: must be one of min-mtf"),
        ({"restoration": "magic"}, "restoration: must be one of wiener"),
        ({"restoration": 3}, "restoration: must be a text"),
        ({"restoration": "math:pi"}, "restoration: math:pi is no function"),
        (
            {"restoration": "math:no_such"},
            "restoration: math:no_such: the module math has no 'no_such'",
        ),
        ({"name": ""}, "name: must be a text"),
        (
            {"restored_by": "luck"},
            "restored_by: must be one of psf, path, estimate, blind, got 'luck'",
        ),
        ({"open_range": [6]}, "open_range: must be two numbers"),
        ({"open_range": 6}, "open_range: must be two numbers"),
        ({"open_range": [10, 6]}, "open_range: must be two numbers"),
        ({"open_range": [6, 17]}, "within 1..16 in order"),
        ({"photons": [0]}, "photons: must be a list of light levels"),
        ({"photons": 300.0}, "photons: must be a list of light levels"),
        ({"photons": ["bright"]}, "photons: must be a list of light levels"),
        ({"photons": [9, 9.0]}, "photons: every level must come once"),
        ({"quick_photons": [-1.0]}, "quick_photons: must be a list of light levels"),
        ({"calibration_photons": "bright"}, "calibration_photons: must be a number"),
        ({"read_noise_e": -1}, "read_noise_e: must be a number within 0..10000"),
        ({"codes": 3}, "field 'codes' is unknown"),
        ({"chips": None}, "field 'chips' is missing"),
    ],
)
def test_a_bad_field_is_one_line_that_names_it(tmp_path, changes, message):
    path = written(tmp_path / "mine.toml", **changes)
    with pytest.raises(ValueError, match=r"mine\.toml: ") as error:
        coded_protocol(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"photos = = 3", b"\xff\xfe"])
def test_a_file_that_is_no_protocol(tmp_path, content):
    (tmp_path / "mine.toml").write_bytes(content)
    with pytest.raises(ValueError, match=r"mine\.toml: not a TOML file"):
        coded_protocol(str(tmp_path / "mine.toml"))


@pytest.mark.parametrize(
    ("name", "message"), [("theirs", "must be one of paper, ours"), ("no.toml", "no such file")]
)
def test_no_such_protocol(name, message):
    with pytest.raises(ValueError, match=message):
        coded_protocol(name)


def test_the_package_carries_its_protocols():
    for name in protocol.PROTOCOLS:
        path = Path(protocol.__file__).with_name(f"{name}.toml")
        assert tomllib.loads(path.read_text())["name"] == name


# -- motions --------------------------------------------------------------------------------------


def test_every_motion_fits_the_frame(monkeypatch):
    """A motion that speeds up lies off-centre: of 60 px it may leave the frame of 64, and is drawn
    again."""
    many = replace(TINY, motions=3 * 80)
    assert max(path.frame_size() for path in drawn_motions(many)) <= 64
    monkeypatch.setattr(protocol, "PSF_PX", 1000)
    assert max(path.frame_size() for path in drawn_motions(many)) > 64


def test_motions_are_the_protocols():
    first, second, third = drawn_motions(replace(TINY, motions=3))
    np.testing.assert_array_equal(
        drawn_motions(TINY)[1].xy, second.xy
    )  # a quick run's are the full one's first
    assert not np.array_equal(drawn_motions(replace(TINY, seed=1))[0].xy, first.xy)
    assert all(20 <= path.length_px <= 60 for path in (first, second, third))
    assert (len(first.t), len(third.t)) == (
        2000,
        2,
    )  # a random walk, then a bent one, then a straight one
    (shake,) = drawn_motions(replace(TINY, shakes="boracchi-foi", motions=1))
    assert shake.length_px == pytest.approx(60)


# -- photos ---------------------------------------------------------------------------------------


def test_paths_are_kept_to_the_last_bit():
    paths = (drawn_motions(TINY)[0], BENT, Trajectory.straight(1 / 3, direction="known"))
    weights = (0.1, 1 / 3, 0.7)
    again, kept = paths_from(paths_to(paths, weights))
    assert kept == weights
    for path, same in zip(paths, again, strict=True):
        np.testing.assert_array_equal(path.t, same.t)
        np.testing.assert_array_equal(path.xy, same.xy)
        assert path.direction == same.direction
    assert paths_to(again, kept) == paths_to(paths, weights)


@pytest.mark.parametrize("borders", ["real", "symmetric"])
@pytest.mark.parametrize("light_true", [True, False])
def test_a_still_camera_takes_the_target_pixel_for_pixel(borders, light_true):
    still = Trajectory.straight(1e-9)
    taken = photographed(**shown(still, bits="1100", borders=borders, light_true=light_true))
    side = 128 if borders == "symmetric" else 128 - PSF_PX + 1
    assert taken.photo.shape == taken.target.shape == taken.restored.shape == (side, side)
    light = 0.5 if light_true else 1.0
    np.testing.assert_allclose(taken.photo, light * taken.target, atol=3e-4)
    np.testing.assert_allclose(taken.restored, taken.target, atol=2e-3)


def test_real_borders_show_what_comes_from_outside():
    """Brute force: each pixel of the photo is the scene summed up along the path, as long as the
    shutter is open."""
    code = ShutterCode(LOPSIDED)
    taken = photographed(**shown(BENT, borders="real"))
    t = (np.arange(16 * 40) + 0.5) / (16 * 40)
    at = BENT.at(t)[np.repeat(code.array, 40) == 1]
    scene = blocks(128)
    row = 3
    column = 60
    total = 0.0
    for dx, dy in at:  # what is displaced by (dx, dy) came from (-dx, -dy)
        y = 31 + row - dy
        x = 31 + column - dx
        i = int(np.floor(y))
        j = int(np.floor(x))
        u = y - i
        v = x - j
        total += (1 - u) * ((1 - v) * scene[i, j] + v * scene[i, j + 1])
        total += u * ((1 - v) * scene[i + 1, j] + v * scene[i + 1, j + 1])
    assert taken.photo[row, column] == pytest.approx(total / t.size, abs=1e-3)


def test_a_coded_photo_has_the_light_that_came_through():
    duty = ShutterCode(LOPSIDED).duty
    true, equal = (photographed(**shown(BENT, light_true=flag)) for flag in (True, False))
    np.testing.assert_allclose(true.photo, duty * equal.photo, atol=1e-4)
    np.testing.assert_allclose(
        true.restored, equal.restored, atol=0.02
    )  # but for rounding to code values
    dim = Camera(photons_full_scale=300.0, read_noise_e=5.0, black_level=0.1).to_dict()
    short = {"bits": "1010010000000000", "camera": dim}
    dark, lit = (
        take_photo(**shown(BENT, light_true=flag, **short))["psnr_db"] for flag in (True, False)
    )
    assert lit > dark + 1


@pytest.mark.parametrize("light_true", [True, False])
def test_with_the_true_psf_and_no_noise_the_oracles_code_restores_far_better_than_an_open_shutter(
    light_true,
):
    motion = Trajectory.straight(24.0, angle_rad=0.4)
    code = design_code(
        "oracle",
        MotionPrior((motion,), (1.0,)),
        chips=16,
        open_range=(6, 10),
        objective="min-mtf",
        camera=Camera(),
        steps=2000,
        rng=np.random.default_rng(0),
    )
    coded, plain = (
        take_photo(**shown(motion, bits=bits, light_true=light_true, restoration="inverse"))
        for bits in (code.bits, "1" * 16)
    )
    assert coded["psnr_db"] > plain["psnr_db"] + 6
    assert coded["ssim"] > plain["ssim"]
    assert coded["min_mtf"] > 10 * plain["min_mtf"]


@pytest.mark.parametrize("light_true", [True, False])
def test_a_hidden_direction_is_found(light_true):
    """Restored by a path of unknown direction it is as good as by the true PSF, whichever way the
    camera ran."""
    options = {"light_true": light_true, "camera": Camera(photons_full_scale=1e6).to_dict()}
    for truth in (BENT, BENT.reversed()) if light_true else (BENT.reversed(),):
        told = take_photo(**shown(truth, **options))["psnr_db"]
        found = take_photo(**shown(truth, assumed=BENT, **options))["psnr_db"]
        assert found == pytest.approx(told, abs=0.05)
    wrong = take_photo(
        **shown(BENT.reversed(), assumed=replace(BENT, direction="known"), **options)
    )["psnr_db"]
    assert wrong < told - 3


@pytest.mark.parametrize(("length_px", "lost_db"), [(32.0, 0.01), (30.7, 0.5)])
def test_a_scene_that_is_merely_displaced_is_as_good(length_px, lost_db):
    """A snapshot at the end of a straight motion, taken for one at its start: the same PSF, 20 px
    or less away.

    Two of 16 chips are open, their middle at 13/16 of the path.
    """
    straight = Trajectory.straight(length_px)
    scene = ndimage.gaussian_filter(
        blocks(128), 1.5
    )  # of sharp steps, sampling between pixels would ring
    options = {
        "bits": "0" * 12 + "1100",
        "scene": scene,
        "camera": Camera(photons_full_scale=1e5).to_dict(),
    }
    told = take_photo(**shown(straight, **options))["psnr_db"]
    backwards = replace(straight.reversed(), direction="known")
    assert take_photo(**shown(straight, assumed=backwards, **options))["psnr_db"] == pytest.approx(
        told, abs=lost_db
    )
    # a PSF of another shape is no better for lying where it should
    across = replace(Trajectory.straight(length_px, angle_rad=1.5), direction="known")
    assert take_photo(**shown(straight, assumed=across, **options))["psnr_db"] < told - 3


def test_run_backwards_a_code_is_its_mirror_image():
    figures, mirrored = (
        take_photo(**shown(BENT, bits=bits)) for bits in (LOPSIDED, LOPSIDED[::-1])
    )
    assert figures["reversed_noise_gain_db"] == pytest.approx(mirrored["noise_gain_db"], abs=1e-6)
    assert figures["noise_gain_db"] == pytest.approx(mirrored["reversed_noise_gain_db"], abs=1e-6)
    assert abs(figures["noise_gain_db"] - figures["reversed_noise_gain_db"]) > 0.01
    assert figures["noise_gain_db"] == measure(BENT, ShutterCode(LOPSIDED)).noise_gain_db


def test_noise_gain_is_that_of_the_light_the_photo_has():
    """As if coding cost no light, a code's gain is the deconvolution noise factor, relative to
    DC."""
    true, equal = (take_photo(**shown(BENT, light_true=flag)) for flag in (True, False))
    metrics = measure(BENT, ShutterCode(LOPSIDED))
    assert true["noise_gain_db"] == metrics.noise_gain_db
    assert equal["noise_gain_db"] == pytest.approx(metrics.dnf_db, abs=1e-9)


def test_the_wiener_filter_is_told_the_cameras_noise():
    dim = Camera(photons_full_scale=300.0, read_noise_e=5.0, black_level=0.1)
    arguments = shown(BENT, camera=dim.to_dict())
    taken = photographed(**arguments)
    told = wiener(taken.photo, taken.psf, camera=dim, border_rounds=10)
    np.testing.assert_array_equal(taken.restored, np.clip(told, 0, 1))


# -- estimates ------------------------------------------------------------------------------------

GUESS = Trajectory.straight(7.0, angle_rad=1.0)
PARAMETRIC = Trajectory.straight(9.0)


class Guesses:
    """Stands in for the slow estimators: always the same motions; at a call it fails or stops."""

    def __init__(self):
        self.photos = []
        self.fails = 0
        self.stops = 0

    def __call__(self, names):
        self.path = PARAMETRIC if names == ["parametric"] else GUESS
        return dict.fromkeys(names, self)

    def estimate(self, photo):
        self.photos.append(photo)
        if len(self.photos) == self.stops:
            raise KeyboardInterrupt
        if len(self.photos) == self.fails:
            raise ValueError("photo: too dark")
        return MotionEstimate("guess", (self.path, BENT), (0.75, 0.25), self.path.psf(32), 0.4)


@pytest.fixture
def guesses(monkeypatch):
    made = Guesses()
    monkeypatch.setattr("lab.evaluation.methods.named_estimators", made)
    return made


def test_motion_is_estimated_from_the_uncoded_photo(guesses):
    arguments = {"method": "motdiff", "borders": "real", "camera": CLEAN, "seed": 0}
    found = estimate_motion(blocks(159), paths_to([GUESS], [1.0]), **arguments)
    assert found["mnc"] == pytest.approx(1.0)
    assert found["cpu_s"] >= 0
    paths, weights = paths_from(found["paths"])
    np.testing.assert_array_equal(paths[1].xy, BENT.xy)
    assert weights == (0.75, 0.25)
    (photo,) = guesses.photos
    assert photo.shape == (96, 96)
    open_shutter = photographed(**shown(GUESS, bits="1", borders="real", side=159)).photo
    np.testing.assert_allclose(photo, open_shutter, atol=3e-4)
    assert estimate_motion(blocks(159), paths_to([BENT], [1.0]), **arguments)["mnc"] < 0.9


# -- designs --------------------------------------------------------------------------------------

TOLD = {
    "none": MotionPrior(),
    "class": MotionPrior((BENT, GUESS), (0.5, 0.5)),
    "length": MotionPrior(length_px=20.0),
    "ours": MotionPrior((BENT, GUESS), (0.75, 0.25)),
    **dict.fromkeys(
        (*CALIBRATIONS, POINT), MotionPrior((replace(BENT, direction="known"),), (1.0,))
    ),
    "parametric": MotionPrior((PARAMETRIC,), (1.0,)),
    "parametric oracle": MotionPrior((PARAMETRIC,), (1.0,)),
    "true": MotionPrior((BENT,), (1.0,)),
}


def chosen(design, known=None, **options):
    return design_code(
        design,
        known or TOLD[DESIGNS[design].path],
        **{
            "chips": 16,
            "open_range": (6, 8),
            "objective": "noise",
            "camera": Camera(),
            "steps": 800,
            "rng": np.random.default_rng(0),
            **options,
        },
    )


@pytest.mark.parametrize("design", DESIGNS)
def test_codes_keep_the_limits_that_are_theirs(design):
    code = chosen(design)
    if design == "open":
        assert code.bits == "1" * 16
    elif design in ("snapshot", "class-snapshot"):
        assert code.pulses == 1
    elif design == "strobe":
        assert code.pulses >= 2
        assert len(set(code.bits.strip("0").rstrip("1").split("1")) - {""}) <= 1  # gaps all alike
    elif design == "raskar-52":
        assert code == published("raskar-52").code
    elif design == "dce":
        assert code == DCE_CODE
    else:
        assert (code.chips, 6 <= code.open_chips <= 8) == (16, True)


def test_an_unknown_design():
    with pytest.raises(ValueError, match=r"design: must be one of open, .*, got 'theirs'"):
        chosen("theirs", MotionPrior())


def test_each_design_minimises_what_it_should():
    """Brute force over all codes of four chips out of eight: the worst of both directions, or the
    given one alone."""
    codes = [
        ShutterCode("".join("01"[k in on] for k in range(8))) for on in combinations(range(8), 4)
    ]

    def gain(path, code):
        return measure(path, code, budget=0).noise_gain_db

    along = {code.bits: (gain(BENT, code), gain(BENT.reversed(), code)) for code in codes}
    limits = {"chips": 8, "open_range": (4, 4), "steps": 2000}
    known = MotionPrior((BENT,), (1.0,))
    ordered = MotionPrior((replace(BENT, direction="known"),), (1.0,))
    for design, prior in [
        ("one-way", known),
        ("oracle", known),
        ("parametric-oracle", known),
        ("calibrated-4", ordered),
        ("calibrated-point", ordered),
    ]:
        assert along[chosen(design, prior, **limits).bits][0] == pytest.approx(
            min(a for a, _ in along.values()), abs=0.05
        )
    for design in (
        "both-ways",
        "parametric",
        "calibrated-point",
    ):  # the direction of this path is not known
        found = along[chosen(design, known, **limits).bits]
        assert max(found) == pytest.approx(min(map(max, along.values())), abs=0.05)
    # a posterior weighs its paths: of a sure one nothing else is left
    sure = MotionPrior((BENT, GUESS), (1.0, 0.0))
    assert chosen("posterior", sure, **limits) == chosen("both-ways", sure, **limits)
    torn = chosen("posterior", MotionPrior((BENT, GUESS), (0.1, 0.9)), **limits)
    means = {code.bits: 0.1 * max(along[code.bits]) + 0.9 * gain(GUESS, code) for code in codes}
    assert means[torn.bits] == pytest.approx(min(means.values()), abs=0.05)
    # DNF sees a straight path only
    straight = {code.bits: gain(Trajectory.straight(20.0), code) for code in codes}
    assert straight[chosen("dnf", **limits).bits] == pytest.approx(
        min(straight.values()), abs=0.05
    )


def test_searches_use_one_thread_and_the_same_budget(monkeypatch):
    real = recipe.anneal
    seen = []

    def watched(problem, **options):
        seen.append(options)
        return real(problem, **options)

    monkeypatch.setattr(recipe, "anneal", watched)
    for design in ("dnf", "oracle", "posterior"):
        chosen(design)
    assert [(options["threads"], options["steps"]) for options in seen] == [(1, 800)] * 3


@pytest.mark.parametrize("design", ["dnf", "oracle"])
def test_an_interrupted_search_is_not_taken_for_a_finished_one(monkeypatch, design):
    """The search itself returns its best so far after Ctrl-C; kept as a cell it would stand for
    the whole budget."""
    real = recipe.anneal

    def stop(_fraction, _best):
        raise KeyboardInterrupt

    monkeypatch.setattr(
        recipe, "anneal", lambda problem, **options: real(problem, **options | {"progress": stop})
    )
    with pytest.raises(KeyboardInterrupt):
        chosen(design, steps=10**6)


# -- the whole ------------------------------------------------------------------------------------

KNOWING = ("open", "dnf", "oracle", "parametric-oracle")


@pytest.fixture
def coarse_walks(monkeypatch):
    """Random walks of 100 points instead of 2000: the table's other parts do not depend on it, and
    their time does."""
    monkeypatch.setattr(protocol, "boracchi_foi", partial(boracchi_foi, samples=100))


@pytest.fixture
def photos(tmp_path, coarse_walks):
    write_image(tmp_path / "blocks.png", blocks(96), gamma="linear")
    return {"blocks": tmp_path / "blocks.png"}


def untouchable(*_arguments):
    pytest.fail("a finished cell was made again")


def test_a_tiny_table_and_its_cells_found_again(tmp_path, monkeypatch):
    tiny = replace(TINY, chips=32, open_range=(13, 19))
    write_image(tmp_path / "camera.png", data.camera()[192:320, 192:320] / 255.0, gamma="linear")
    photos = {"camera": tmp_path / "camera.png"}
    measured = measure_coded(tiny, photos, engine=Engine(tmp_path / "cells"), designs=KNOWING)
    assert (measured.outcome.reasons, measured.outcome.missing, measured.outcome.warnings) == (
        {},
        0,
        (),
    )
    assert [(shot.design, shot.motion) for shot in measured.shots] == [
        (name, i) for name in KNOWING for i in range(2)
    ]
    assert measured.estimates == {}
    by_name = {(shot.design, shot.motion): shot for shot in measured.shots}
    gains_db = []
    for motion in range(2):
        coded = by_name["oracle", motion]
        plain = by_name["open", motion]
        gains_db.append(coded.figures["psnr_db"] - plain.figures["psnr_db"])
        # pairs: nothing but the code differs
        assert {**coded.arguments, "bits": ""} == {**plain.arguments, "bits": ""}
    assert (
        np.mean(gains_db) > 1
    )  # not each: the objective is the noise alone, and one photo has more than noise
    assert not any(
        shot.arguments["light_true"] for shot in measured.shots
    )  # without light levels, light is no matter
    assert by_name["open", 0].arguments["seed"] != by_name["open", 1].arguments["seed"]
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    again = measure_coded(tiny, photos, engine=Engine(tmp_path / "cells"), designs=KNOWING)
    assert [(shot.bits, shot.figures) for shot in again.shots] == [
        (s.bits, s.figures) for s in measured.shots
    ]


def test_who_restores_by_what(tmp_path, photos, guesses):
    hidden = replace(
        TINY, restored_by="estimate", motions=1, shakes="boracchi-foi", photons=(1e5,), steps=200
    )
    names = ("dnf", "snapshot", "parametric", "parametric-oracle", "oracle")
    measured = measure_coded(hidden, photos, engine=Engine(tmp_path / "cells"), designs=names)
    assert measured.outcome.reasons == {}
    assert set(measured.estimates) == {("ours", "blocks", 0), ("parametric", "blocks", 0)}
    assumed = {shot.design: shot.arguments["assumed"] for shot in measured.shots}
    assert assumed.pop("oracle") is None
    paths = {name: paths_from(text)[0][0] for name, text in assumed.items()}
    (truth,) = drawn_motions(hidden)
    expected = dict.fromkeys(("dnf", "snapshot"), GUESS) | {
        "parametric": PARAMETRIC,
        "parametric-oracle": nearest_quadratic(truth).trajectory(),
    }
    for name, path in expected.items():
        np.testing.assert_array_equal(paths[name].xy, path.xy)
        assert paths[name].direction == "unknown"
    assert all(shot.arguments["light_true"] for shot in measured.shots)


def test_a_restoration_may_know_the_path_but_not_its_direction(tmp_path, photos, guesses):
    hidden = replace(
        TINY, restored_by="path", motions=1, shakes="boracchi-foi", photons=(1e5,), steps=200
    )
    measured = measure_coded(
        hidden,
        photos,
        engine=Engine(tmp_path / "cells"),
        designs=("open", "both-ways", "parametric-oracle", "oracle"),
    )
    assert measured.outcome.reasons == {}
    (truth,) = drawn_motions(hidden)
    oracles = [shot for shot in measured.shots if "oracle" in shot.design]
    assert [shot.arguments["assumed"] for shot in oracles] == [
        None,
        None,
    ]  # their codes are made for one direction
    for shot in measured.shots:
        if shot in oracles:
            continue
        (path,), _ = paths_from(shot.arguments["assumed"])
        np.testing.assert_array_equal(path.xy, truth.xy)
        assert path.direction == "unknown"


def test_codes_are_searched_for_the_light_that_they_meet(tmp_path, photos):
    """In the dark, where read noise rules, the oracle keeps its shutter open longer; the DNF code
    is one for all."""
    lit = replace(
        TINY, objective="mse", open_range=(1, 16), photons=(50.0, 1e6), read_noise_e=5.0, motions=1
    )
    measured = measure_coded(
        lit, photos, engine=Engine(tmp_path / "cells"), designs=("raskar-52", "dnf", "oracle")
    )
    bits = {(shot.design, shot.photons): shot.bits for shot in measured.shots}
    assert bits["oracle", 50.0].count("1") > bits["oracle", 1e6].count("1")
    assert bits["dnf", 50.0] == bits["dnf", 1e6]
    (truth,) = drawn_motions(lit)
    for level in lit.levels:
        camera = lit.camera(level)
        known = {
            b: measure(truth, ShutterCode(b), camera=camera, budget=0).mse_db
            for (d, _), b in bits.items()
            if d == "oracle"
        }
        assert min(known, key=known.__getitem__) == bits["oracle", level]
    # neither the same searches nor the same codes twice
    assert len(list((tmp_path / "cells").glob("*.json"))) == 1 + 1 + 2 + 3 * 2


def test_a_code_of_ones_own_is_a_row_that_counts_anew_when_it_changes(
    tmp_path, photos, monkeypatch
):
    options = {"engine": Engine(tmp_path / "cells"), "designs": ("open",)}
    tiny = replace(TINY, motions=1)
    measured = measure_coded(
        tiny,
        photos,
        codes={"mine": ShutterCode(LOPSIDED), "all": ShutterCode("1" * 16)},
        **options,
    )
    plain, mine, everything = measured.shots
    assert [one.design for one in measured.shots] == ["open", "mine", "all"]
    assert mine.bits == LOPSIDED
    assert {**mine.arguments, "bits": ""} == {**plain.arguments, "bits": ""}
    assert (
        everything.figures == plain.figures
    )  # the same code is the same photo, whatever its row is called
    assert {"mine", "all"} < set(coded_tables(measured)[0].rows)
    assert len(list((tmp_path / "cells").glob("*.json"))) == 1 + 2
    other = measure_coded(
        tiny, photos, codes={"mine": ShutterCode(LOPSIDED[::-1])}, **options
    ).shots[1]
    assert (other.bits, other.figures != mine.figures) == (LOPSIDED[::-1], True)
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    assert (
        measure_coded(tiny, photos, codes={"mine": ShutterCode(LOPSIDED)}, **options)
        .shots[1]
        .figures
        == mine.figures
    )
    for name in ("open", "", "a|b"):
        with pytest.raises(ValueError, match=r"^code: "):
            measure_coded(tiny, photos, codes={name: ShutterCode("1011")}, **options)


def test_a_code_of_ones_own_is_restored_along_our_estimate(tmp_path, photos, guesses):
    hidden = replace(TINY, restored_by="estimate", motions=1)
    (mine,) = measure_coded(
        hidden,
        photos,
        engine=Engine(tmp_path / "cells"),
        designs=(),
        codes={"mine": ShutterCode(LOPSIDED)},
    ).shots
    np.testing.assert_array_equal(paths_from(mine.arguments["assumed"])[0][0].xy, GUESS.xy)


@pytest.fixture
def own_restorations(tmp_path, monkeypatch):
    """Two modules of the user's own in the current folder."""
    monkeypatch.chdir(tmp_path)
    for name, factor in (("own_halving", 0.5), ("own_doubling", 2.0)):
        Path(f"{name}.py").write_text(
            f"def restored(photo, psf):\n    return {factor} * photo / psf.sum()\n"
        )
    yield
    for name in ("own_halving", "own_doubling"):
        sys.modules.pop(name, None)


def test_a_restoration_of_ones_own_restores_the_table(tmp_path, photos, own_restorations):
    own = coded_protocol(
        written(tmp_path / "mine.toml", restoration="own_halving:restored", motions=1)
    )
    measured = measure_coded(own, photos, engine=Engine(tmp_path / "cells"), designs=("open",))
    assert measured.outcome.reasons == {}
    taken = pictures_of(**measured.shots[0].arguments)
    np.testing.assert_allclose(taken.restored, np.clip(0.5 * taken.photo, 0, 1), atol=1e-9)
    # its module counts, also where nothing else differs
    versions = {
        photo_version(name) for name in ("wiener", "own_halving:restored", "own_doubling:restored")
    }
    assert len(versions) == 3
    assert photo_version("wiener") == photo_version("tv")  # these are arguments of the cells


def test_only_estimates_that_are_needed_are_made(tmp_path, photos, guesses):
    measured = measure_coded(
        replace(TINY, motions=1, restored_by="estimate"),
        photos,
        engine=Engine(tmp_path / "cells"),
        designs=["oracle"],
    )
    assert (guesses.photos, len(measured.shots)) == ([], 1)


@pytest.mark.parametrize(
    ("restored_by", "left"),
    [("psf", ["open", "open", "snapshot"]), ("estimate", ["open", "snapshot"])],
)
def test_a_failed_estimate_leaves_its_photos_out(tmp_path, photos, guesses, restored_by, left):
    guesses.fails = 1
    measured = measure_coded(
        replace(TINY, restored_by=restored_by),
        photos,
        engine=Engine(tmp_path / "cells"),
        designs=("open", "snapshot"),
    )
    assert measured.outcome.reasons == {"motion/ours/blocks/0": "photo: too dark"}
    assert [shot.design for shot in measured.shots] == left
    snapshots = [shot for shot in measured.shots if shot.design == "snapshot"]
    assert [shot.motion for shot in snapshots] == [1]
    guesses.fails = 0
    mended = measure_coded(
        replace(TINY, restored_by=restored_by),
        photos,
        engine=Engine(tmp_path / "cells"),
        designs=("open", "snapshot"),
    )
    assert (mended.outcome.reasons, len(mended.shots), len(guesses.photos)) == ({}, 4, 3)


def test_stopped_it_tells_and_goes_on_later(tmp_path, photos, guesses):
    guesses.stops = 2
    cache = tmp_path / "cells"
    stopped = measure_coded(TINY, photos, engine=Engine(cache), designs=("open", "snapshot"))
    assert (stopped.outcome.missing, stopped.shots) == (1, ())
    uncoded = photographed(**shown(drawn_motions(TINY)[0], bits="1", side=96)).photo
    np.testing.assert_allclose(
        guesses.photos[0], uncoded, atol=0.002
    )  # no light levels: no noise here either
    assert coded_tables(stopped) == []
    report = coded_report(stopped, MADE)
    assert report.figure is None
    assert list(report.texts) == [*TABLE_ENDINGS, "-photos.csv"]
    whole = measure_coded(TINY, photos, engine=Engine(cache), designs=("open", "snapshot"))
    assert (whole.outcome.missing, len(whole.shots), len(guesses.photos)) == (0, 4, 3)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["open", "theirs"], "designs: must be among open, .*'theirs'"),
        (["open", "open"], "each must come once"),
    ],
)
def test_designs_are_refused_before_any_work(tmp_path, photos, names, message):
    with pytest.raises(ValueError, match=message):
        measure_coded(TINY, photos, engine=Engine(tmp_path / "cells"), designs=names)
    assert not (tmp_path / "cells").exists()


def test_a_changed_method_is_measured_again_alone(monkeypatch):
    before = (
        {design: code_version(design) for design in DESIGNS},
        photo_version("pnp"),
        motion_version("parametric"),
    )
    real = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda self: b"new" if self.suffix == ".safetensors" else real(self)
    )
    after = (
        {design: code_version(design) for design in DESIGNS},
        photo_version("pnp"),
        motion_version("parametric"),
    )
    assert before[0] == after[0]  # no code is chosen by a network
    assert before[1] != after[1]  # the denoiser's, with which a protocol may restore
    assert before[2] != after[2]
    assert set(ESTIMATORS.values()) == {"motdiff", "parametric"}
    assert motion_version("ours") != motion_version("parametric")


# -- tables ---------------------------------------------------------------------------------------


def shot(design, photo, motion, psnr_db, gains=(10.0, 10.0), photons=None):
    figures = {
        "psnr_db": psnr_db,
        "ssim": 0.5,
        "noise_gain_db": gains[0],
        "reversed_noise_gain_db": gains[1],
        "min_mtf": 0.1,
    }
    return Shot(design, photo, motion, photons, figures, "10", {})


def table_of(shots, **changes):
    return CodedTable(replace(TINY, **changes), tuple(shots), {}, Outcome((), 0, ()))


def test_harm_is_counted_in_the_worse_direction():
    gains = [(9.0, 9.5), (9.0, 10.5), (11.0, 3.0), (10.0, 10.0)]
    shots = [shot("both-ways", "a", i, 30.0, gain) for i, gain in enumerate(gains)]
    shots += [shot("open", "a", i, 20.0) for i in range(3)]
    assert harmed(table_of(shots), "both-ways") == (
        2,
        3,
    )  # the fourth has nothing to be compared with
    assert harmed(table_of(shots), "open") == (0, 3)
    assert harmed(table_of(shots), "one-way") == (0, 0)


def test_differences_are_ours_less_theirs_and_count_photos_and_motions():
    shots = [shot("open", photo, i, 20.0 + i) for photo in "abcdef" for i in range(8)]
    shots += [
        shot("both-ways", photo, i, 25.0 + i + ord(photo) % 2)
        for photo in "abcdef"
        for i in range(8)
    ]
    # the protocol asks for more photos than there were
    quality, less, gain = coded_tables(table_of(shots, photos=100, motions=8))
    ours = DESIGNS["both-ways"].label
    plain = DESIGNS["open"].label
    assert list(less.rows) == [plain]
    (psnr, ssim) = less.rows[plain]
    assert psnr.summary.mean == pytest.approx(5.5)
    assert ssim.summary.mean == 0
    assert quality.rows[ours][0].bold
    entries = (quality.rows[ours][0], psnr)
    assert {entry.interval.clusters for entry in entries} == {6}
    assert (
        entries[0].interval.high - entries[0].interval.low > 4
    )  # motions differ by 2.4 dB, photos by half one
    assert gain.rows[ours][1].interval is None
    few = [one for one in shots if one.motion < 2]
    assert coded_tables(table_of(few))[0].rows[ours][0].interval.clusters == 2


@pytest.mark.parametrize("photons", [(), (1e4,)])
def test_rows_that_know_the_truth_or_pay_no_light_are_no_rivals(photons):
    best = {
        "oracle": 40.0,
        "parametric-oracle": 39.0,
        "snapshot": 38.0,
        "strobe": 37.0,
        "both-ways": 30.0,
        "open": 20.0,
    }
    level = photons[0] if photons else None
    shots = [
        shot(name, p, i, psnr + i, photons=level)
        for name, psnr in best.items()
        for p in "abc"
        for i in range(3)
    ]
    rivals, apart, *_ = coded_tables(table_of(shots, photons=photons))
    limits = {"oracle", "parametric-oracle"} | (set() if photons else {"snapshot", "strobe"})
    assert set(apart.rows) == {DESIGNS[name].label for name in limits}
    assert set(rivals.rows) == {DESIGNS[name].label for name in set(best) - limits}
    assert not any(entry.bold for entries in apart.rows.values() for entry in entries)
    leader = "snapshot" if photons else "both-ways"
    assert [label for label, entries in rivals.rows.items() if entries[0].bold] == [
        DESIGNS[leader].label
    ]


def test_a_line_of_zeros_is_an_infinite_noise_gain_and_medians_bear_it():
    straight = Trajectory.straight(30.0)
    figures = take_photo(**shown(straight, bits="1" * 16))
    assert figures["noise_gain_db"] == figures["reversed_noise_gain_db"] == np.inf
    assert np.isfinite(take_photo(**shown(straight, bits="1110100110101000"))["noise_gain_db"])
    gains = [(np.inf, np.inf), (20.0, 21.0), (22.0, 22.0)]
    shots = [shot("open", p, i, 20.0, gain) for i, gain in enumerate(gains) for p in "ab"]
    gain = coded_tables(table_of(shots))[-1]
    assert gain.lines()[0][1:3] == ("22.00", "22.00")
    # and how many have a zero is told, where some have
    assert gain.lines()[0][gain.head.index("zeros, share")] == "0.33"
    sound = [one for one in shots if one.motion]
    assert "zeros, share" not in coded_tables(table_of(sound))[-1].head


@pytest.mark.parametrize("design", ["one-way", "both-ways", "oracle"])
def test_a_search_is_never_worse_than_a_snapshot_that_keeps_its_limits(design):
    known = MotionPrior((BENT,), (1.0,))
    limits = {"open_range": (1, 16), "objective": "mse"}
    dark = Camera(photons_full_scale=300.0, read_noise_e=5.0)
    codes = [
        design_code(
            name,
            known,
            chips=16,
            camera=dark,
            steps=40_000,
            rng=np.random.default_rng(0),
            **limits,
        )
        for name in (design, "snapshot")
    ]
    ways = (BENT,) if design in ("one-way", "oracle") else (BENT, BENT.reversed())
    ours, short = (
        max(measure(way, code, camera=dark, budget=0).mse_db for way in ways) for code in codes
    )
    assert ours <= short + 1e-6


def test_a_stopped_run_has_a_table_of_what_is_there(tmp_path):
    """The reference was reached at the first light level only."""
    dim = 300.0
    bright = 1e4
    shots = [
        shot("open", "a", i, 20.0, photons=level) for level in (dim, bright) for i in range(2)
    ]
    shots += [shot("both-ways", "a", i, 21.0, photons=dim) for i in range(2)]
    titles = [table.title for table in coded_tables(table_of(shots, photons=(dim, bright)))]
    assert titles == [
        "Coded exposure, tiny, 300 photo-electrons",
        f"{DESIGNS['both-ways'].label} less each other row, 300 photo-electrons",
        "Noise gain of the codes along the true motion, 300 photo-electrons",
        "Coded exposure, tiny, 10,000 photo-electrons",
        "Noise gain of the codes along the true motion, 10,000 photo-electrons",
    ]


def test_every_photo_is_in_the_csv():
    shots = [shot("open", "a", 0, 20.25, (np.inf, 10.0)), shot("dnf", "a", 1, 21.0, photons=300.0)]
    first, second = csv.DictReader(io.StringIO(shots_csv(table_of(shots))))
    assert (first["design"], first["photons"], float(first["psnr_db"])) == ("open", "", 20.25)
    assert float(first["noise_gain_db"]) == np.inf
    assert (second["motion"], second["photons"], second["bits"]) == ("1", "300", "10")


def test_the_picture_needs_no_level_that_was_not_reached(tmp_path, photos):
    dim = replace(TINY, photons=(300.0, 1e4), motions=1)
    measured = measure_coded(dim, photos, engine=Engine(tmp_path / "cells"), designs=("open",))
    reached = replace(measured, shots=tuple(one for one in measured.shots if one.photons == 300.0))
    assert len(reached.shots) == 1
    report = coded_report(reached, MADE)
    assert report.figure is not None
    assert "in neither direction" not in report.texts[".md"]


# -- one code for a class -------------------------------------------------------------------------


def test_the_class_is_of_the_protocols_kind_and_none_of_its_motions():
    walks = replace(TINY, shakes="boracchi-foi")
    shown = drawn_motions(walks)
    others = class_motions(walks)
    assert len(others) == 60
    assert all(path.length_px == pytest.approx(60, abs=1) for path in others)  # thinned
    assert not any(np.allclose(path.xy[-1], one.xy[-1]) for path in others for one in shown)


def test_all_photos_have_the_same_class_code():
    """Brute force over all codes of four chips out of eight, by the mean of the decibels."""
    codes = [
        ShutterCode("".join("01"[k in on] for k in range(8))) for on in combinations(range(8), 4)
    ]
    paths = class_motions(TINY)[:2]
    gains = {
        code.bits: np.mean([measure(path, code, budget=0).noise_gain_db for path in paths])
        for code in codes
    }
    found = chosen("class", MotionPrior(paths, (0.5, 0.5)), chips=8, open_range=(4, 4), steps=2000)
    assert gains[found.bits] == pytest.approx(min(gains.values()), abs=0.05)


def test_a_class_code_is_searched_once(tmp_path, photos, monkeypatch):
    kept = class_motions(TINY)[:2]
    monkeypatch.setattr("lab.bench.coded.run.class_motions", lambda _protocol: kept)
    measured = measure_coded(TINY, photos, engine=Engine(tmp_path / "cells"), designs=["class"])
    assert not measured.outcome.reasons
    assert len({shot.bits for shot in measured.shots}) == 1


# -- calibrations by other photos than an open one ------------------------------------------------


def test_photos_of_a_calibration_are_moved_by_their_own_shifts():
    codes = codes_of_set("open+gray2", 8)
    shifts_px = [[1.5, -0.5], [0.0, 0.0], [-2.0, 1.0]]
    psfs = moved_psfs([BENT] * 3, codes, shifts_px)
    assert psfs.sum(axis=(1, 2)) == pytest.approx([1.0, 0.5, 0.5])
    still = moved_psfs([BENT] * 3, codes, np.zeros((3, 2)))
    for psf, unmoved, shift_px in zip(psfs, still, shifts_px, strict=True):
        centroids = [np.array(centroid_px(one))[::-1] for one in (psf, unmoved)]
        np.testing.assert_allclose(centroids[0] - centroids[1], shift_px, atol=1e-9)


def test_calibration_photos_have_their_codes_light():
    dim = Camera(photons_full_scale=1e9, read_noise_e=0.0, bits=16)
    options = {"camera": dim, "borders": "real"}
    for light_true, light in ((True, 0.5), (False, 1.0)):
        plain, coded = calibration_photos(
            np.full((128, 128), 0.6),
            BENT,
            ["1" * 8, "11001010"],
            rng=np.random.default_rng(0),
            light_true=light_true,
            **options,
        )
        assert plain.shape == coded.shape
        assert coded.mean() / plain.mean() == pytest.approx(light, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "message"), [("theirs", "'theirs' is no code"), ("open", "order cannot be known")]
)
def test_a_set_that_tells_no_order_is_refused(name, message):
    with pytest.raises(ValueError, match=message):
        codes_of_set(name, 16)


class Knowing:
    """Stands in for the estimator of coded photos: it knows the path."""

    made: ClassVar[list[tuple[str, ...]]] = []
    path = Trajectory.straight(9.0)
    stops = 0

    def __init__(self, codes, *, seed):
        self.codes = tuple(codes)

    def estimate_from(self, photos):
        assert len(photos) == len(self.codes)
        self.made.append(self.codes)
        if len(self.made) == self.stops:
            raise KeyboardInterrupt
        # its photos are light through its codes: the open one is the brightest
        assert max(photos, key=np.mean) is photos[0]
        known = replace(drawn_motions(CALIBRATED)[len(self.made) - 1], direction="known")
        return MotionEstimate("coded", (known,), (1.0,), known.psf(64), 0.9)


CALIBRATED = replace(
    TINY,
    photons=(1e4,),
    objective="mse",
    borders="real",
    crop_px=96,
    restored_by="psf",
    restoration="wiener",
)


@pytest.fixture
def knowing(monkeypatch):
    monkeypatch.setattr("motdiff.estimators.coded.estimator.CodedEstimator", Knowing)
    Knowing.made, Knowing.stops = [], 0
    return Knowing


@pytest.fixture
def two_photos(tmp_path, coarse_walks):
    for seed, name in enumerate(("a", "b")):
        write_image(tmp_path / f"{name}.png", blocks(160, seed), gamma="linear")
    return {name: tmp_path / f"{name}.png" for name in ("a", "b")}


def test_calibrated_by_an_estimator_that_knows_the_path_a_row_is_the_true_paths(
    tmp_path, two_photos, knowing
):
    """Motions are calibrated once for all photos, and the code along the path found is that along
    the true one."""
    measured = measure_coded(
        CALIBRATED,
        two_photos,
        engine=Engine(tmp_path / "cells"),
        designs=("oracle", "calibrated-4"),
    )
    assert measured.outcome.reasons == {}
    assert knowing.made == [codes_of_set("open+gray3", 16)] * 2
    rows = {
        name: [shot for shot in measured.shots if shot.design == name]
        for name in ("oracle", "calibrated-4")
    }
    assert [shot.bits for shot in rows["calibrated-4"]] == [shot.bits for shot in rows["oracle"]]
    assert [shot.figures for shot in rows["calibrated-4"]] == [
        shot.figures for shot in rows["oracle"]
    ]
    assert all(figures["error_px"] < 1e-9 for (kind, *_), figures in measured.estimates.items())
    quality, _, less, _ = coded_tables(measured)
    assert less.rows[DESIGNS["oracle"].label][0].summary.mean == 0
    assert quality.head[-2:] == ("n", "motions")
    assert quality.lines()[0][-2:] == ("4", "2")
    report = coded_report(measured, MADE)
    assert "open + three: 2 of mean MNC 1.000" in report.texts[".md"]


def test_a_stopped_calibration_is_made_again_and_the_finished_one_kept(
    tmp_path, two_photos, knowing
):
    knowing.stops = 2
    stopped = measure_coded(
        CALIBRATED, two_photos, engine=Engine(tmp_path / "cells"), designs=("calibrated-4",)
    )
    assert (stopped.outcome.missing > 0, stopped.shots) == (True, ())
    knowing.made.pop()
    knowing.stops = 0
    whole = measure_coded(
        CALIBRATED, two_photos, engine=Engine(tmp_path / "cells"), designs=("calibrated-4",)
    )
    assert (whole.outcome.missing, len(whole.shots), len(knowing.made)) == (0, 4, 2)


def test_calibrated_rows_are_measured_where_they_are_named():
    assert not {name for name in USUAL_DESIGNS if name.startswith("calibrated")}
    assert {"both-ways", "oracle", "class"} <= set(USUAL_DESIGNS)


def test_a_point_light_through_a_code_shows_the_path_and_its_direction():
    angle = np.linspace(0, np.pi / 2, 60)
    arc = Trajectory.from_samples(
        10 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), direction="known"
    )
    found = motion_from_light(motion=paths_to([arc], [1.0]), camera=Camera().to_dict(), seed=0)
    path = paths_from(found["paths"])[0][0]
    assert path.direction == "known"
    assert found["error_px"] == pytest.approx(timed_distance_px(path, arc), abs=1e-3)
    assert found["error_px"] < 0.3
    assert timed_distance_px(path.reversed(), arc) > 3
    assert found["mnc"] > 0.95


def test_edits_of_what_finds_a_calibrated_path_count(monkeypatch):
    real = run.source_version
    seen = []

    def watched(modules, **others):
        seen.extend(modules)
        return real(modules, **others)

    monkeypatch.setattr(run, "source_version", watched)
    versions = {motion_version(kind) for kind in (POINT, "one coded")}
    assert len(versions) == 2
    assert TrailEstimator.__module__ in seen
    assert CodedEstimator.__module__ in seen


# -- restored blind -------------------------------------------------------------------------------


def test_restored_with_its_kernel_a_photo_is_as_with_its_psf():
    psf = coded_psf(BENT, ShutterCode(LOPSIDED), PSF_PX)
    away = moved(psf, down_px=7, right_px=-5)  # a blind kernel lies anywhere
    for light_true in (True, False):
        known, blind = (
            take_photo(**shown(BENT, light_true=light_true, kernel=kernel))
            for kernel in (None, psf_to_text(away / away.sum()))
        )
        assert blind["psnr_db"] == pytest.approx(known["psnr_db"], abs=0.02)


class Finder:
    """Stands in for the search of PMP: it keeps the photos and finds a dot."""

    photos: ClassVar[list[np.ndarray]] = []

    def __init__(self, progress=None):
        pass

    def estimate(self, photo):
        self.photos.append(photo)
        dot = np.zeros((64, 64))
        dot[32, 32] = 1.0
        return MotionEstimate("pmp", (BENT,), (1.0,), dot, 0.4)


def test_kernels_are_searched_in_the_photos_that_are_restored(tmp_path, two_photos, monkeypatch):
    monkeypatch.setattr("motdiff.estimators.pmp.estimator.PmpEstimator", Finder)
    Finder.photos = []
    blind = replace(CALIBRATED, restored_by="blind", motions=1, photos=1)
    photos = {"a": two_photos["a"]}
    own = {"mine": ShutterCode("1100101000110101")}
    measured = measure_coded(
        blind, photos, engine=Engine(tmp_path / "cells"), designs=("open", "oracle"), codes=own
    )
    assert [shot.design for shot in measured.shots] == ["open", "oracle", "mine"]
    for shot, searched in zip(measured.shots, Finder.photos, strict=True):
        taken = pictures_of(**shot.arguments)
        duty = ShutterCode(shot.bits).duty
        level = searched.max() / taken.photo.max()
        assert 1 <= level <= 1 / duty + 1e-9
        np.testing.assert_allclose(searched, level * taken.photo, atol=1e-12)
        target = visible(sharp_scene(shot.arguments["photo"], shot.arguments["cut"]), PSF_PX)
        assert taken.target.shape == target.shape
        assert 0 < shot.figures["kernel_mnc"] < 1
    titles = [table.title for table in coded_tables(measured)]
    assert "mine less each other row, 10,000 photo-electrons" in titles


# -- changed fields -------------------------------------------------------------------------------


def test_fields_of_a_protocol_may_be_changed():
    changed = coded_protocol(
        "ours", ["motions=20", "photons=[10000, 1e5]", "restored_by=blind", "name='dim'"]
    )
    assert (changed.motions, changed.photons, changed.restored_by) == (20, (1e4, 1e5), "blind")
    assert changed.name == "dim"
    assert replace(
        changed, motions=9, photons=coded_protocol("ours").photons, restored_by="path", name="ours"
    ) == (coded_protocol("ours"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("codes=3", "set: must be FIELD=VALUE with one of bits, .*, got 'codes=3'"),
        ("motions", "set: motions needs a number"),
        ("motions=0", "motions: must be a whole number within 1..10000, got 0"),
        ("motions=many", "motions: must be a whole number within 1..10000, got 'many'"),
        ("photons=[1", r"set: photons needs a number, a text or a list as \[1, 2\], got '\[1'"),
        ("motions=1\nphotos=2", "set: motions needs a number"),
    ],
)
def test_a_change_that_is_none_is_one_line(change, message):
    with pytest.raises(ValueError, match=message) as error:
        coded_protocol("ours", [change])
    assert "\n" not in str(error.value)
