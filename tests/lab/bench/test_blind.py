"""The blind table: its protocols, its photos, its versions of methods, and what is summed up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat

from cep.files.images import read_image, write_image
from lab.bench.blind import report
from lab.bench.blind.cases import make_case, real_pair, real_photos, shot_of
from lab.bench.blind.cells import (
    TimedEstimator,
    measure_levin,
    measure_real,
    measure_simulated,
)
from lab.bench.blind.methods import (
    SMALL_BUDGETS,
    budget_warning,
    label_of,
    select_methods,
    version_of,
)
from lab.bench.blind.plan import blind_plan, one_cell_each
from lab.bench.blind.protocol import (
    Motions,
    Protocol,
    drawn_shakes,
    paired_shakes,
    synthetic_trace,
)
from lab.bench.blind.report import blind_tables, cells_csv
from lab.bench.psf_text import psf_from_text, psf_to_text
from lab.jobs import fingerprint
from lab.jobs.fingerprint import source_version
from lab.weights import PATH_WEIGHTS, PSF_WEIGHTS
from motdiff.metrics import mnc
from motdiff.photo_values import luminance
from motdiff.simulate import blur_symmetric, blur_valid, valid_window
from motdiff.trajectory import Trajectory
from motdiff.weights import DEFAULT_WEIGHTS, read_network_card

TINY = Protocol("tiny", 2, 2, crop_px=96, psf_px=32, motion=Motions(max_length_px=16.0))


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.png"
    blocks = np.kron(np.random.default_rng(0).random((18, 18)), np.ones((8, 8)))
    write_image(path, 0.1 + 0.8 * blocks, bits=16, gamma="linear")
    return path


# -- protocols ------------------------------------------------------------------------------------


def test_the_papers_protocol_is_the_papers():
    """arXiv 2510.26173, section IV-A: 10 photos x 100 motions, 256-px crops, 64-px PSFs, mirrored
    borders, no noise."""
    paper = Protocol.load("paper")
    assert (paper.photos, paper.motions, paper.crop_px, paper.psf_px, paper.borders) == (
        10,
        100,
        256,
        64,
        "symmetric",
    )
    assert (paper.levels, paper.gamma, paper.motion) == (
        (None,),
        "linear",
        Motions(max_length_px=60.0),
    )
    assert paper.least_px == 256
    quick = Protocol.load("paper", quick=True)
    assert quick == replace(
        paper, photos=quick.photos, motions=quick.motions, real_photos=quick.real_photos
    )
    assert quick.photos * quick.motions < 10


def test_ours_has_real_borders_and_five_light_levels():
    ours = Protocol.load("ours")
    assert (ours.borders, ours.gamma, len(ours.levels), ours.least_px) == (
        "real",
        "srgb",
        5,
        256 + 63,
    )
    assert min(ours.motion.boracchi_foi, ours.motion.gyro) > 0
    assert ours.read_noise_e > 0


def test_the_cards_protocols_give_every_photo_one_motion():
    walks, gyro = (Protocol.load(f"card-{name}") for name in ("walks", "gyro"))
    assert (walks.pairs, gyro.pairs, walks.motions, gyro.motions) == ("each", "each", 16, 16)
    assert (walks.borders, walks.read_sigma, gyro.borders, gyro.read_sigma) == (
        "symmetric",
        0.0,
        "real",
        0.01,
    )
    assert (walks.motion, gyro.motion) == (Motions(), Motions(0.0, 1.0))
    assert walks.grey
    assert gyro.grey


def test_a_protocol_of_ones_own_is_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        "photos = 3\nmotions = 4\nlight_photons = [100]\n[motion]\nmax_length_px ="
        " 20\n[quick]\nphotos = 1\n"
    )
    mine = Protocol("mine", 3, 4, light_photons=(100.0,), motion=Motions(max_length_px=20.0))
    assert Protocol.load(path) == mine
    assert Protocol.load(str(path), quick=True) == replace(mine, photos=1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("photos = 3", "motions: is missing"),
        ("photos = 3\nmotions = 0", "motions: must lie within 1..10000, got 0"),
        ("photos = 3\nmotions = 2.5", "motions: must be of type int, got 2.5"),
        ("photos = true\nmotions = 2", "photos: must be of type int"),
        ("photos = 3\nmotions = 2\nchips = 52", "chips: is not known"),
        ("photos = 3\nmotions = 2\npsf_px = 65", "psf_px: must lie within 8..64"),
        ("photos = 3\nmotions = 2\nborders = 'open'", "borders: must be"),
        ("photos = 3\nmotions = 2\ngamma = '2.2'", "gamma: must be"),
        ("photos = 3\nmotions = 2\nlight_photons = [0]", "light_photons: must lie within"),
        (
            "photos = 3\nmotions = 2\nlight_photons = [9, 9]",
            "light_photons: every level must come once",
        ),
        ("photos = 3\nmotions = 2\nlight_photons = 9", "light_photons: must be a list of numbers"),
        ("photos = 3\nmotions = 2\nread_noise_e = 3", "read_noise_e: needs light_photons"),
        (
            "photos = 3\nmotions = 2\nlight_photons = [9]\nread_noise_e = -1",
            "read_noise_e: must lie within",
        ),
        ("photos = 3\nmotions = 2\nread_sigma = 2", "read_sigma: must lie within"),
        (
            "photos = 3\nmotions = 2\nread_sigma = 0.1\nlight_photons = [9]",
            "read_sigma: not valid with light_photons",
        ),
        ("photos = 3\nmotions = 2\ngrey = 1", "grey: must be of type bool, got 1"),
        ("photos = 3\nmotions = 2\npairs = 'some'", "pairs: must be"),
        ("photos = 3\nmotions = 2\npairs = 'each'\npsf_px = 32", "psf_px: must be 64 px"),
        ("photos = 3\nmotions = 2\nmotion = 3", "motion: must be a section"),
        (
            "photos = 3\nmotions = 2\n[motion]\nboracchi_foi = 0",
            "boracchi_foi and gyro: must be shares",
        ),
        ("photos = 3\nmotions = 2\n[motion]\nmax_length_px = 0", "max_length_px: must lie within"),
        (
            "photos = 3\nmotions = 2\n[motion]\nextent_px = [9, 3]",
            "extent_px: must be two numbers",
        ),
        (
            "photos = 3\nmotions = 2\n[motion]\nextent_px = [9]",
            "extent_px: must be a list of 2 numbers",
        ),
        ("photos = 3\nmotions = 2\n[quick]\nphotos = -1", "photos: must lie within"),
        ("photos = ", "not a TOML file"),
    ],
)
def test_what_is_wrong_in_a_protocol_is_named(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        Protocol.load(path)  # a mistake in [quick] is found without --quick
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_an_unknown_protocol_is_named():
    with pytest.raises(
        ValueError,
        match=(
            r"protocol: must be paper, ours, card-walks, card-gyro, or a \.toml file, got 'theirs'"
        ),
    ):
        Protocol.load("theirs")
    with pytest.raises(FileNotFoundError):
        Protocol.load("nowhere.toml")


# -- motions and photos ---------------------------------------------------------------------------


def test_a_motion_depends_on_its_number_and_the_seed_only():
    few = drawn_shakes(replace(TINY, motions=2))
    many = drawn_shakes(replace(TINY, motions=5))
    for one, other in zip(few, many[:2], strict=True):
        np.testing.assert_array_equal(one.xy, other.xy)
    assert all(motion.frame_size() <= 32 for motion in many)
    for other in (drawn_shakes(replace(TINY, seed=1)), drawn_shakes(TINY, stream=1)):
        assert not np.array_equal(few[0].xy, other[0].xy)


def test_hand_shake_has_the_extent_that_was_asked_for():
    shaken = drawn_shakes(
        replace(TINY, motions=6, motion=Motions(0.0, 1.0, extent_px=(10.0, 12.0)))
    )
    assert all(10 - 1e-9 <= motion.extent_px <= 12 + 1e-9 for motion in shaken)
    assert synthetic_trace().rate_rad_s.std() == pytest.approx(0.1)


EACH = Protocol(
    "each", 2, 5, pairs="each", crop_px=96, read_sigma=0.02, motion=Motions(max_length_px=30.0)
)


def test_with_one_motion_each_photos_come_in_turns(tmp_path, monkeypatch):
    monkeypatch.setattr("lab.bench.blind.plan._OTHERS", 3)
    for name in ("a.png", "b.png"):
        write_image(tmp_path / name, np.random.default_rng(0).random((100, 100)))
    plan = blind_plan(EACH, ["pmp"], folder=tmp_path)
    mine = [cell for cell in plan.cells if cell.name[0] == "pmp"]
    assert [cell.name[1:] for cell in mine] == [
        (label, f"{i:04d}", "noise 0.02") for i, label in enumerate("ababa")
    ]
    assert len({cell.arguments["motion"].xy.tobytes() for cell in mine}) == 5
    assert report._counts(plan) == "2 photos, 5 motions, 5 pairs of them"


def test_one_generator_draws_motion_crop_and_noise(scene):
    """Case i depends on the seed and i only, and a colour photo may be taken in grey."""
    few = paired_shakes(replace(EACH, motions=2))
    many = paired_shakes(EACH)
    assert all(motion.length_px == pytest.approx(30) for motion, _ in many)
    for (one, state), (other, same_state) in zip(few, many[:2], strict=True):
        np.testing.assert_array_equal(one.xy, other.xy)
        assert state == same_state
    for elsewhere in (paired_shakes(replace(EACH, seed=1)), paired_shakes(EACH, others=2)):
        assert not np.array_equal(few[0][0].xy, elsewhere[0][0].xy)
    protocol = replace(EACH, grey=True)
    cases = [
        make_case(scene, motion, shot_of(protocol, "scene", 0, None, state))
        for motion, state in (few[0], *few)
    ]
    np.testing.assert_array_equal(cases[0].photo, cases[1].photo)
    assert not np.array_equal(cases[0].sharp, cases[2].sharp)
    noise = cases[0].photo - blur_symmetric(cases[0].sharp, cases[0].psf)
    assert cases[0].photo.shape == (96, 96)
    assert noise.std() == pytest.approx(0.02, rel=0.05)


def test_hand_shake_of_one_motion_each_has_the_extent_that_was_asked_for():
    shaken = paired_shakes(replace(EACH, motion=Motions(0.0, 1.0, extent_px=(10.0, 12.0))))
    assert all(10 - 1e-9 <= motion.extent_px <= 12 + 1e-9 for motion, _ in shaken)


def test_motions_that_cannot_fit_are_refused():
    with pytest.raises(ValueError, match="did not fit psf_px = 8 px"):
        drawn_shakes(replace(TINY, psf_px=8, motion=Motions(max_length_px=200.0)))


@pytest.mark.parametrize(
    ("borders", "blur"), [("symmetric", blur_symmetric), ("real", blur_valid)]
)
def test_a_photo_is_its_sharp_scene_blurred(scene, borders, blur):
    protocol = replace(TINY, borders=borders)
    motion = Trajectory.straight(9.0)
    case = make_case(scene, motion, shot_of(protocol, "scene", 0, None))
    assert case.photo.shape == case.sharp.shape == (96, 96)
    assert case.trajectory is motion
    assert case.psf.shape == (32, 32)
    inner = blur_valid(case.sharp, case.psf)
    np.testing.assert_allclose(case.photo[15:-16, 15:-16], inner, atol=1e-12)
    if borders == "symmetric":
        expected = blur(case.sharp, case.psf)
    else:
        # of the whole scene, at the place of the crop: light from beyond the border is in it
        whole = luminance(read_image(scene, gamma="linear"))
        blurred = np.full(whole.shape, np.nan)
        blurred[valid_window(whole.shape, case.psf.shape)] = blur(whole, case.psf)
        places = np.lib.stride_tricks.sliding_window_view(whole, case.sharp.shape)
        ((row, column),) = np.argwhere((places == case.sharp).all(axis=(2, 3)))
        expected = blurred[row : row + 96, column : column + 96]
    np.testing.assert_allclose(case.photo, expected, atol=1e-12)


def test_noise_is_that_of_the_light_and_the_sensor(scene):
    motion = Trajectory.straight(9.0)
    clean = make_case(scene, motion, shot_of(TINY, "scene", 0, None)).photo
    noisy = make_case(
        scene,
        motion,
        shot_of(replace(TINY, read_noise_e=6.0, light_photons=(400.0,)), "scene", 0, 400.0),
    )
    expected = clean.mean() / 400 + (6 / 400) ** 2
    assert (noisy.photo - clean).var() == pytest.approx(
        expected, rel=0.06
    )  # 9216 pixels: sd 1.5 %
    other = make_case(
        scene,
        motion,
        shot_of(replace(TINY, read_noise_e=6.0, light_photons=(400.0,)), "scene", 1, 400.0),
    )
    assert (
        abs(np.corrcoef((noisy.photo - clean).ravel(), (other.photo - clean).ravel())[0, 1]) < 0.05
    )


def test_every_motion_meets_the_same_crop(scene):
    shots = [shot_of(replace(TINY, motions=n), "scene", i, None) for n, i in ((1, 0), (5, 3))]
    sharp = [
        make_case(scene, Trajectory.straight(5.0 + i), shot).sharp for i, shot in enumerate(shots)
    ]
    np.testing.assert_array_equal(*sharp)


# -- real photos ----------------------------------------------------------------------------------


def write_levin(folder, names=("im01_ker01", "im01_ker02")):
    rng = np.random.default_rng(3)
    for number, name in enumerate(names):
        sharp = np.kron(rng.random((12, 12)), np.ones((8, 8)))
        kernel = Trajectory.straight(6.0 + 2 * (number % 4)).psf(15)
        savemat(
            folder / f"{name}.mat",
            {"x": sharp, "y": blur_symmetric(sharp, np.rot90(kernel, 2)), "f": kernel},
        )


def write_rsblur(folder, scene="0001", number="000002", *, side=100):
    rng = np.random.default_rng(1)
    sharp = np.kron(rng.random((side // 4, side // 4)), np.ones((4, 4)))
    at = folder / scene / number
    for name, image in (("gt/gt_sharp.png", sharp), ("real_blur/real_blur.png", 0.5 * sharp)):
        (at / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(at / name, image, bits=16, gamma="linear")
    return at


def test_levins_photos_come_with_their_kernels(tmp_path):
    write_levin(tmp_path)
    photos = real_photos(tmp_path, 10)
    assert [(photo.scene, photo.shake) for photo in photos] == [
        ("im01", "ker01"),
        ("im01", "ker02"),
    ]
    assert real_photos(tmp_path, 1) == photos[:1]
    write_levin(tmp_path, [f"im0{i}_ker0{k}" for i in range(1, 5) for k in range(1, 5)])
    few = [(photo.scene, photo.shake) for photo in real_photos(tmp_path, 4)]
    assert few == [(f"im0{i}", f"ker0{i}") for i in range(1, 5)]
    knows, not_at_all = (
        measure_levin(method=method, photo=photos[0].blurred)
        for method in ("true-kernel", "delta")
    )
    assert knows["mnc"] == pytest.approx(1.0)
    assert knows["psnr_db"] > not_at_all["psnr_db"] + 2
    plan = blind_plan(TINY, ["pmp"], folder=tmp_path)
    assert [cell.name for cell in plan.cells[:4]] == [
        (method, "im01", "ker01", "Levin's real shakes")
        for method in ("delta", "gaussian", "pmp", "true-kernel")
    ]


def test_rsblurs_pairs_are_cut_at_the_same_place(tmp_path):
    write_rsblur(tmp_path)
    (photo,) = real_photos(tmp_path, 5)
    assert (photo.scene, photo.shake) == ("0001", "000002")
    blurred, sharp = real_pair(photo, crop_px=64, gamma="linear", crop_seed=(4,))
    np.testing.assert_allclose(blurred, 0.5 * sharp, atol=1e-4)
    figures = measure_real(
        method="delta",
        blurred=photo.blurred,
        sharp=photo.sharp,
        crop_px=64,
        gamma="linear",
        crop_seed=(4,),
    )
    assert figures["mnc"] is None
    assert figures["psnr_db"] == pytest.approx(
        -10 * np.log10(np.mean((0.5 * sharp[15:-15, 15:-15]) ** 2)), abs=1.0
    )


def test_pairs_must_be_pairs(tmp_path):
    at = write_rsblur(tmp_path)
    write_image(at / "gt" / "gt_sharp.png", np.full((90, 100), 0.5))
    (photo,) = real_photos(tmp_path, 5)
    with pytest.raises(
        ValueError,
        match=r"real_blur\.png: has the shape \(100, 100\), its sharp photo \(90, 100\)",
    ):
        real_pair(photo, crop_px=64, gamma="linear", crop_seed=(4,))
    (at / "real_blur" / "real_blur.png").unlink()
    with pytest.raises(ValueError, match=r"000002: lacks real_blur/real_blur\.png"):
        real_photos(tmp_path, 5)


def test_koehlers_photos_have_no_truth(tmp_path):
    for name in ("Blurry1_1.png", "Blurry1_2.png"):
        write_image(tmp_path / name, np.random.default_rng(0).random((100, 100)))
    plan = blind_plan(TINY, ["pmp"], folder=tmp_path)
    assert [cell.name[:3] for cell in plan.cells] == [
        ("pmp", "Blurry1", "1"),
        ("pmp", "Blurry1", "2"),
    ]
    assert all(cell.arguments["sharp"] is None for cell in plan.cells)


def test_real_photos_are_counted_with_their_scenes(tmp_path):
    write_levin(tmp_path)
    assert (
        report._counts(blind_plan(TINY, ["pmp"], folder=tmp_path))
        == "2 photos with real blur, of 1 scene"
    )


def test_a_file_that_is_no_mat_file_is_named(tmp_path):
    (tmp_path / "im01_ker01.mat").write_bytes(b"something else, and long enough to look at " * 9)
    with pytest.raises(ValueError, match=r"im01_ker01\.mat: cannot be read as a \.mat file"):
        measure_levin(method="delta", photo=tmp_path / "im01_ker01.mat")


# -- work and versions ----------------------------------------------------------------------------


def test_figures_tell_knowing_from_guessing(scene):
    motion = drawn_shakes(TINY)[0]
    shot = shot_of(TINY, "scene", 0, None)
    mean = Trajectory.straight(8.0).psf(32)
    rows = {
        method: measure_simulated(method=method, photo=scene, motion=motion, shot=shot, mean=mean)
        for method in ("delta", "mean-kernel", "true-path", "true-kernel")
    }
    assert rows["true-kernel"]["mnc"] == pytest.approx(1.0)
    assert rows["mean-kernel"]["mnc"] == pytest.approx(mnc(mean, motion.psf(32)))
    assert rows["delta"]["mnc_subpixel"] < rows["true-path"]["mnc_subpixel"] < 1
    assert rows["delta"]["psnr_db"] + 2 < rows["true-kernel"]["psnr_db"]
    assert rows["delta"]["cpu_s"] is None
    kept = psf_from_text(rows["true-kernel"]["psf"])
    np.testing.assert_allclose(kept, motion.psf(32), atol=2e-4)


def test_a_psf_is_a_short_line_of_text():
    psf = Trajectory.straight(11.0).psf(64)
    text = psf_to_text(psf)
    assert len(text) < 1500
    assert "\n" not in text
    np.testing.assert_allclose(psf_from_text(text), psf, atol=1e-4)
    with pytest.raises(ValueError, match="psf: must be a text of psf_to_text"):
        psf_from_text("64:broken")


def test_an_estimators_cost_is_its_own():
    class Hungry:
        def estimate(self, photo):
            return SimpleNamespace(
                sum=float(np.ones((300, 2**17)).sum()) + photo
            )  # 300 MiB, given back

    watched = TimedEstimator(Hungry())
    assert watched.estimate(1.0).sum == 300 * 2**17 + 1
    assert watched.wall_s > 0
    if watched.memory_mib is None:
        pytest.skip("this system does not tell how much memory a process holds")
    assert 290 < watched.memory_mib < 400
    watched.estimator = SimpleNamespace(estimate=lambda photo: photo)
    watched.estimate(1.0)
    assert watched.memory_mib < 20  # the last peak is forgotten


def forget():
    for known in (
        fingerprint._file,
        fingerprint._tree,
        fingerprint._imports,
        fingerprint._meaning,
    ):
        known.cache_clear()


def test_a_version_changes_with_the_code_and_not_with_its_comments(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    path = tmp_path / "bench_probe.py"
    weights = tmp_path / "weights"
    weights.write_bytes(b"1")

    def version(text):
        path.write_text(text)
        forget()
        return source_version(["bench_probe"], files=[weights])

    first = version('"""A."""\n\n\ndef f(x):\n    """B."""\n    return x + 1\n')
    assert version('"""C."""\ndef f(x):\n    return (x + 1)  # why\n') == first
    assert version("def f(x):\n    return x + 2\n") != first
    inside = version(
        "def f(x):\n    from lab.bench import datasets as photos\n    return photos\n"
    )
    assert inside != version("def f(x):\n    from cep.optics import code\n    return code\n")
    weights.write_bytes(b"2")
    assert inside != version(
        "def f(x):\n    from lab.bench import datasets as photos\n    return photos\n"
    )
    with pytest.raises(ValueError, match=r"module: there is no cep\.nowhere"):
        source_version(["cep.nowhere"])
    forget()


def test_a_compiled_module_counts_by_its_file():
    """A user's own may be one."""
    compiled = source_version(["numpy._core._multiarray_umath"])
    assert compiled != source_version(["numpy._core"])
    with pytest.raises(ValueError, match="there is no sys, or it has no file"):
        source_version(["sys"])


def test_every_method_has_a_version_of_its_own_code():
    versions = [version_of(method) for method in ("pmp", "motdiff", "delta")]
    assert len(set(versions)) == 3
    assert version_of("network:ddpm:50") == version_of("network")


@pytest.mark.parametrize("method", ["pmp", "motdiff", "delta", "true-kernel"])
@pytest.mark.parametrize(
    "module",
    [
        *(
            "lab.bench.datasets",
            "cep.files.images",
            "motdiff.simulate",
            "motdiff.photo_values",
            "motdiff.metrics",
        ),
        *("lab.evaluation.sets", "motdiff.trajectory", "lab.bench.blind.cells"),
        *("motdiff.files.decoding", "motdiff.files.mat_files"),
    ],
)
def test_a_version_changes_with_what_takes_and_measures_the_photo(monkeypatch, module, method):
    first = version_of(method)
    read = fingerprint._meaning
    assert version_of(method) == first
    monkeypatch.setattr(
        fingerprint, "_meaning", lambda name: "another" if name == module else read(name)
    )
    assert version_of(method) != first


def test_the_weights_of_the_correction_count_for_what_reads_them(monkeypatch, tmp_path):
    (tmp_path / "other.safetensors").write_bytes(b"1")
    names = ("motdiff", "networks", "network", "pmp")
    first = {name: version_of(name) for name in names}
    monkeypatch.setattr(
        "lab.bench.blind.methods.CORRECTION_WEIGHTS", tmp_path / "other.safetensors"
    )
    assert [name for name in names if version_of(name) != first[name]] == ["motdiff", "networks"]


def test_a_folder_of_weights_counts_by_its_content_and_is_named_without_its_place(tmp_path):
    (tmp_path / "priors").mkdir()
    (tmp_path / "priors" / "image.safetensors").write_bytes(b"1")
    method = f"blinddps:{tmp_path / 'priors'}"
    assert label_of(method) == "blinddps:priors"
    assert label_of("network:ddpm:50") == "network:ddpm:50"
    first = version_of(method)
    (tmp_path / "priors" / "image.safetensors").write_bytes(b"2")
    assert version_of(method) != first


def test_a_file_of_weights_counts_by_its_content_and_is_named_without_its_place(
    tmp_path, monkeypatch
):
    file = tmp_path / "run.safetensors"
    file.write_bytes(b"1")
    method = f"network:ddim:10@{file}"
    assert label_of(method) == "network:ddim:10@run.safetensors"
    first = version_of(method)
    assert first != version_of("network:ddim:10")
    file.write_bytes(b"2")
    assert version_of(method) != first
    monkeypatch.setattr("lab.bench.blind.methods.named_estimators", lambda _: {})
    monkeypatch.chdir(tmp_path)
    assert select_methods(["network@run.safetensors"]) == ((f"network@{file}",), [])
    with pytest.raises(
        ValueError, match=r"every one must come once, network@run\.safetensors comes twice"
    ):
        select_methods(["network@run.safetensors", f"network@{file}"])


def test_methods_are_checked_before_the_work(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="method: must be one of"):
        select_methods(["guess"])
    with pytest.raises(ValueError, match="methods: every one must come once, pmp comes twice"):
        select_methods(["pmp", "pmp"])
    monkeypatch.setattr(
        "lab.bench.blind.methods._WEIGHTS", {"parametric": tmp_path / "none.safetensors"}
    )
    with pytest.raises(
        ValueError,
        match=r"parametric has no weights in this package \(none\.safetensors is missing\)",
    ):
        select_methods(["parametric"])
    names, warnings = select_methods([])
    assert names == ("motdiff", "pmp", "network", "psf-diffusion")
    assert warnings == ["parametric is left out: none.safetensors is not in this package"]


def test_smaller_budgets_are_told_as_the_weights_say():
    """Samples are updates times the batch, in the header of the weights; MoTDiff had three runs,
    its card tells."""
    for method, path in (("parametric", PATH_WEIGHTS), ("psf-diffusion", PSF_WEIGHTS)):
        card = read_network_card(path)
        samples = card["run"]["steps"] * card["config"]["optimiser"]["batch"]
        assert samples == SMALL_BUDGETS[method]
        assert f"{method} {samples:,} from 704" in budget_warning(["pmp", f"{method}"])
    card = read_network_card(DEFAULT_WEIGHTS)
    told = card["card"]["samples"]
    assert f"{card['run']['steps'] * card['config']['optimiser']['batch']:,}" in told
    assert f"MoTDiff's {told.split()[0]} samples" in budget_warning(["psf-diffusion:4"])
    assert budget_warning(["pmp", "motdiff", "delta"]) is None


# -- tables ---------------------------------------------------------------------------------------


def figures(values, light="no noise"):
    """Cells of MNC by (method, photo, motion)."""
    return {
        (m, p, s, light): {"mnc": value, "cpu_s": None, "psf": "x"}
        for (m, p, s), value in values.items()
    }


def spread(method, function):
    return {(method, f"p{i}", f"m{j}"): function(i, j) for i in range(6) for j in range(6)}


def test_intervals_count_photos_and_motions():
    rng = np.random.default_rng(0)
    by_motion = rng.random(6)
    cells = figures(
        spread("delta", lambda _i, j: by_motion[j]) | spread("motdiff", lambda i, _j: by_motion[i])
    )
    table, paired = blind_tables(cells, ["no noise"], title="T", seed=0)
    first, second = (table.rows[method][0].interval for method in ("delta", "motdiff"))
    for interval in (first, second):  # over the other grouping they have no spread at all
        assert interval.high - interval.low > 0.2
        assert interval.low < by_motion.mean() < interval.high
    assert [column.figure for column in table.columns] == ["mnc"]
    assert paired.title == "T, no noise: motdiff less each, paired"
    assert list(paired.rows) == ["delta"]


def test_bold_needs_photos_and_motions_to_agree():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 0.01, 36)
    base = spread("pmp", lambda _i, _j: 0.5)
    steady = spread("motdiff", lambda i, j: 0.6 + noise[6 * i + j])
    table, paired = blind_tables(figures(base | steady), ["no noise"], title="T", seed=0)
    assert table.rows["motdiff"][0].bold
    assert paired.rows["pmp"][0].summary.mean == pytest.approx(0.1 + noise.mean())
    one_motion = spread(
        "motdiff", lambda _i, j: 1.1 if j == 0 else 0.5 + 1e-3 * j
    )  # all its lead is from one motion
    table, _ = blind_tables(figures(base | one_motion), ["no noise"], title="T", seed=0)
    assert not table.rows["motdiff"][0].bold


def test_kernels_that_know_the_truth_never_win_the_table():
    cells = figures(
        spread("true-kernel", lambda _i, _j: 1.0)
        | spread("pmp", lambda i, j: 0.5 + 0.01 * i + 0.01 * j)
    )
    methods, limits = blind_tables(cells, ["no noise"], title="T", seed=0)
    assert (list(methods.rows), list(limits.rows)) == (["pmp"], ["true-kernel"])


def test_several_draws_have_a_table_of_their_own():
    cells = figures(
        {("network:ddim:10:8", str(i), "0"): 0.6 + 0.1 * i for i in range(3)}
        | {("pmp", "0", "0"): 0.5}
    )
    for number, own in enumerate(own for name, own in cells.items() if name[0] != "pmp"):
        own |= {"best_draw": 0.8, "draws_alike": 0.7, "covered": float(number > 0)}
    (draws,) = (
        t for t in blind_tables(cells, ["no noise"], title="T", seed=0) if "draws" in t.title
    )
    assert list(draws.rows) == ["network:ddim:10:8"]
    means = [entry.summary.mean for entry in draws.rows["network:ddim:10:8"]]
    assert means == pytest.approx([0.8, 0.7, 2 / 3])


def test_every_light_level_has_its_tables_and_failures_are_told():
    cells = figures({("pmp", "a", "0"): 0.5}, "dark") | figures({("pmp", "a", "0"): 0.7}, "light")
    cells["pmp", "b", "0", "dark"] = {}
    tables = blind_tables(cells, ["light", "dark"], title="T", seed=0)
    assert [(table.title, table.rows["pmp"][0].summary.mean) for table in tables] == [
        ("T, light", pytest.approx(0.7)),
        ("T, dark", pytest.approx(0.5)),
    ]
    assert tables[1].cells["pmp"] == 2
    text = cells_csv(cells, {("pmp", "b", "0", "dark"): "photo: too dark"})
    assert text.splitlines()[-1] == "pmp,b,0,dark" + "," * 14 + "photo: too dark"
    assert text.splitlines()[1].startswith("pmp,a,0,dark,0.5,")


def test_speed_takes_one_motion_per_photo(tmp_path, monkeypatch):
    monkeypatch.setattr("lab.bench.blind.plan._OTHERS", 3)
    for name in ("a.png", "b.png", "c.png"):
        write_image(tmp_path / name, np.random.default_rng(0).random((100, 100)))
    protocol = replace(TINY, photos=3, light_photons=(1000.0, 100.0))
    plan = blind_plan(protocol, ["pmp"], folder=tmp_path)
    assert len(plan.cells) == 3 * 2 * 2 * (3 + 1 + 3)
    assert [cell.name[:3] for cell in one_cell_each(plan).cells] == [
        ("pmp", "a", "0000"),
        ("pmp", "c", "0000"),
        ("pmp", "b", "0001"),
    ]
    assert {cell.name[3] for cell in one_cell_each(plan).cells} == {"1000 photo-electrons"}


def test_photos_are_read_once_as_the_protocol_says(scene):
    light = make_case(
        scene, Trajectory.straight(5.0), shot_of(replace(TINY, gamma="srgb"), "scene", 0, None)
    ).sharp
    code = make_case(scene, Trajectory.straight(5.0), shot_of(TINY, "scene", 0, None)).sharp
    assert light.mean() < code.mean()
    assert code.max() <= read_image(scene, gamma="linear").max()
