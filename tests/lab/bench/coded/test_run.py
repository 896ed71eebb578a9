"""Runs of the coded table: who restores by what, what is cached, what a failure costs."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from coded_table import BENT, GUESS, LOPSIDED, MADE, PARAMETRIC, TINY, blocks, shown, written
from skimage import data

from cep.files.images import write_image
from cep.optics.code import ShutterCode
from cep.proofs.measure import measure
from lab.bench.coded.calibrations import (
    codes_of_set,
)
from lab.bench.coded.designs import DESIGNS, USUAL_DESIGNS
from lab.bench.coded.protocol import (
    class_motions,
    coded_protocol,
    drawn_motions,
)
from lab.bench.coded.report import coded_report
from lab.bench.coded.run import measure_coded
from lab.bench.coded.stages import photographed, pictures_of
from lab.bench.coded.tables import coded_tables
from lab.bench.coded.versions import photo_version
from lab.bench.datasets import sharp_scene
from lab.bench.harness import TABLE_ENDINGS
from lab.evaluation.quadratic_limits import nearest_quadratic
from lab.jobs.engine import Engine
from motdiff.estimators.base import MotionEstimate
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

KNOWING = ("open", "dnf", "oracle", "parametric-oracle")


def but_for_the_code(shot):
    exposure = replace(shot.arguments["exposure"], bits="1")
    parts = {**vars(exposure), "motion": exposure.motion.xy.tolist()}
    return {**shot.arguments, "exposure": parts}


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
        assert but_for_the_code(coded) == but_for_the_code(plain)
    assert (
        np.mean(gains_db) > 1
    )  # not each: the objective is the noise alone, and one photo has more than noise
    assert not any(
        shot.arguments["exposure"].light_true for shot in measured.shots
    )  # without light levels, light is no matter
    first, second = (by_name["open", motion].arguments["exposure"].seed for motion in range(2))
    assert first != second
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
    paths = {shot.design: shot.arguments["assumed"] for shot in measured.shots}
    assert paths.pop("oracle") is None
    (truth,) = drawn_motions(hidden)
    expected = dict.fromkeys(("dnf", "snapshot"), GUESS) | {
        "parametric": PARAMETRIC,
        "parametric-oracle": nearest_quadratic(truth).trajectory(),
    }
    for name, path in expected.items():
        np.testing.assert_array_equal(paths[name].xy, path.xy)
        assert paths[name].direction == "unknown"
    assert all(shot.arguments["exposure"].light_true for shot in measured.shots)


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
        path = shot.arguments["assumed"]
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
    assert but_for_the_code(mine) == but_for_the_code(plain)
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
    np.testing.assert_array_equal(mine.arguments["assumed"].xy, GUESS.xy)


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


def test_a_class_code_is_searched_once(tmp_path, photos, monkeypatch):
    kept = class_motions(TINY)[:2]
    monkeypatch.setattr("lab.bench.coded.run.class_motions", lambda _protocol: kept)
    measured = measure_coded(TINY, photos, engine=Engine(tmp_path / "cells"), designs=["class"])
    assert not measured.outcome.reasons
    assert len({shot.bits for shot in measured.shots}) == 1


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


class Finder:
    """Stands in for the search of PMP: it keeps the photos and finds a dot."""

    photos: ClassVar[list[np.ndarray]] = []

    def __init__(self, progress=None):
        pass

    def estimate_from(self, photos):
        self.photos += photos
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
