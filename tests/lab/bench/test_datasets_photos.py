"""Photos for benchmarks: what a folder holds, which photos are taken, and what is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from cep.calibration.calibrate import CALIBRATION_FILES
from cep.files.code_files import StoredCode, write_code
from cep.files.images import read_image, write_image
from cep.files.psf_files import write_psf
from cep.optics.code import ShutterCode
from cep.report.page import DEMO_FILES, DEMO_SCHEMA
from lab.bench.datasets import bundled_photos, crop, layout_of, photo_folder, pick
from lab.bench.table_io import Provenance, made_json
from lab.fronts.comparison import FRONT_SCHEMA
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.trajectory import Trajectory


def photo(path, *, side=(40, 50), blurred=False, seed=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.random.default_rng(seed).random(side)
    if blurred:
        image = (
            image + np.roll(image, 1, 0) + np.roll(image, 1, 1) + np.roll(image, (1, 1), (0, 1))
        ) / 4
    write_image(path, image, gamma="linear")
    return path


def gopro(root, *, swapped=False):
    for sequence in ("GOPR01", "GOPR02"):
        for number in (1, 2):
            for half in ("sharp", "blur"):
                photo(
                    root / sequence / half / f"{number:06d}.png",
                    blurred=(half == "blur") != swapped,
                    seed=number,
                )
    return root


def test_a_folder_of_photos_is_listed_in_order_with_its_subfolders(tmp_path):
    made = [photo(tmp_path / name) for name in ("b.png", "a/z.tif", "a/y.jpg")]
    photo(tmp_path / "._b.png")  # what macOS leaves beside photos
    (tmp_path / "notes.txt").write_text("no photo")
    assert layout_of(tmp_path) == "photos"
    assert list(photo_folder(tmp_path)) == sorted(made)
    assert photo_folder(str(tmp_path)) == photo_folder(tmp_path)


def test_pictures_of_benchmarks_are_no_photos(tmp_path):
    made = [
        photo(tmp_path / name) for name in ("cep.png", "shots/a.png", "shots/b.png", "shots/c.png")
    ]
    photo(tmp_path / "bench" / "cep.png")
    (tmp_path / "bench" / "cep.json").write_text(made_json({}, Provenance("", 0, [], [])))
    # what others keep beside photos under the same name
    (tmp_path / "shots" / "a.json").write_text('{"schema": "annotations/1"}')
    (tmp_path / "shots" / "b.json").write_bytes(b"\xff")
    (tmp_path / "shots" / "c.json").mkdir()
    assert list(photo_folder(tmp_path)) == sorted(made)
    with pytest.raises(ValueError, match="holds no photos"):
        photo_folder(tmp_path / "bench")


def test_pictures_of_our_commands_are_no_photos(cep, lab, workplace):
    """Of what a day's work leaves in a folder, only what has no record is still taken for
    photos."""
    motion = ("--trajectory", "trajectory.json")
    for command in (
        (
            "calibrate",
            "blurred.png",
            "--method",
            "reference",
            "--sharp",
            "sharp.png",
            "-o",
            ".",
            "--force",
        ),
        (
            "calibrate",
            "blurred.png",
            "--method",
            "reference",
            "--sharp",
            "sharp.png",
            "-o",
            "hand",
        ),
        ("simulate", "sharp.png", *motion, "--code", "code.json"),
        ("simulate", "sharp.png", *motion, "-o", "open.jpg"),
        ("pareto", "--chips", "9", "--time", "0.2", "-o", "front.json"),
        ("mtf", *motion, "--code", "code.json"),
        ("deblur", "sharp_coded.png", *motion, "--code", "code.json"),
    ):
        program = lab if command[0] == "pareto" else cep
        program.succeeds(*command)
    pictures = {
        path.as_posix() for path in workplace.rglob("*") if path.suffix in (".png", ".jpg")
    }
    made = {
        *(
            "psf.png",
            "map.png",
            "preview.png",
            "hand/psf.png",
            "hand/map.png",
            "hand/preview.png",
            "front.png",
        ),
        *("sharpened.png", "hand/sharpened.png"),
        *("sharp_coded.png", "sharp_coded_psf.png", "open.jpg", "open_psf.png"),
    }
    without_record = {"mtf.png", "sharp_coded_sharp.png"}
    given = {"sharp.png", "blurred.png"}
    assert pictures == {(workplace / name).as_posix() for name in made | without_record | given}
    assert layout_of(workplace) == "photos"  # though there are .mat files
    assert {
        path.relative_to(workplace).as_posix() for path in photo_folder(workplace)
    } == without_record | given


def calibrated(folder):
    motion = Trajectory.straight(7.0)
    write_motion(folder / "trajectory.json", StoredMotion(motion))
    write_psf(folder, motion.psf(64))


def test_pictures_of_the_demo_are_no_photos(tmp_path):
    for name in DEMO_FILES:
        if name.endswith(".png"):
            photo(tmp_path / "demo" / name)
    own = photo(tmp_path / "demo" / "a.png")
    calibrated(tmp_path / "demo")
    write_code(tmp_path / "demo" / "code.json", StoredCode(ShutterCode("1101", 250_000)))
    (tmp_path / "demo" / "demo.json").write_text(f'{{"schema": "{DEMO_SCHEMA}"}}')
    assert photo_folder(tmp_path) == (own,)
    (tmp_path / "demo" / "demo.json").write_text('{"schema": "annotations/1"}')
    pictures = {name for name in DEMO_FILES if name.endswith(".png")}
    assert {path.name for path in photo_folder(tmp_path)} == (
        pictures - set(CALIBRATION_FILES)
    ) | {"a.png"}


def beside_a_code(folder):
    """What "cep optimize -o house.json" and "cep hw verify -o house.json" leave beside the photo
    of a house."""
    write_code(folder / "house.json", StoredCode(ShutterCode("1101", 250_000)))
    write_psf(folder, np.eye(9), stem="house_psf")
    return ["house.png"]


def beside_a_motion(folder):
    write_motion(folder / "trajectory.json", StoredMotion(Trajectory.straight(7.0)))
    return ["preview.png", "map.png", "psf.png", "sharpened.png"]


def beside_somebody_elses_arrays(folder):
    """A depth map, say, in the formats of our PSFs."""
    for stem, variables in (
        ("room", {"depth": np.eye(3)}),
        ("wall", {"psf": np.eye(3), "noise": 1.0}),
        ("door", None),
    ):
        np.save(folder / f"{stem}.npy", np.eye(3))
        savemat(folder / f"{stem}.mat", variables) if variables else (
            folder / f"{stem}.mat"
        ).write_bytes(b"MATLAB")
    return ["room.png", "wall.png", "door.png"]


def one_of_two_was_blurred(folder):
    write_psf(folder, np.eye(9), stem="tree_psf")
    return ["tree.png", "tree.jpg"]


def a_photo_named_as_a_table(folder):
    (folder / "cep.json").write_text(made_json({}, Provenance("", 0, [], [])))
    return ["cep.jpg"]


@pytest.mark.parametrize(
    "made",
    [
        *(beside_a_code, beside_a_motion, beside_somebody_elses_arrays, one_of_two_was_blurred),
        a_photo_named_as_a_table,
    ],
)
def test_photos_beside_files_of_ours_stay_photos(tmp_path, made):
    folder = tmp_path / "below"
    folder.mkdir()
    photos = [photo(folder / name) for name in made(folder)]
    assert photo_folder(tmp_path) == tuple(sorted(photos))


def test_any_version_of_a_table_counts(tmp_path):
    (tmp_path / "front.json").write_text(
        f'{{"schema": "{FRONT_SCHEMA.replace("1", "7")}", "points": []}}'
    )
    photo(tmp_path / "front.png")
    with pytest.raises(ValueError, match="holds no photos"):
        photo_folder(tmp_path)


def test_levins_files_are_told_from_psfs(tmp_path):
    calibrated(tmp_path)
    assert layout_of(tmp_path) == "photos"
    savemat(tmp_path / "im05_flit01.mat", {name: np.eye(3) for name in ("x", "y", "f")})
    assert layout_of(tmp_path) == "levin"


def test_only_the_sharp_half_of_gopro_and_rsblur_is_taken(tmp_path):
    root = gopro(tmp_path / "gopro")
    assert layout_of(root) == layout_of(root / "GOPR01") == "gopro"
    assert [path.relative_to(root).as_posix() for path in photo_folder(root)] == [
        f"GOPR0{sequence}/sharp/00000{number}.png" for sequence in (1, 2) for number in (1, 2)
    ]
    rsblur = tmp_path / "rsblur"
    for name in ("real_blur/real_blur.png", "gt/gt_sharp.png", "avg65_img/avg_blur.png"):
        photo(rsblur / "0001" / "000002" / name)
    assert layout_of(rsblur) == "rsblur"
    assert photo_folder(rsblur) == (rsblur / "0001/000002/gt/gt_sharp.png",)


def test_gopros_layout_as_it_is_spread(tmp_path):
    """GOPRO_Large: train and test, two kinds of blur beside the sharp frames of every film."""
    for number, place in enumerate(
        ("train/GOPR0372_07_00", "train/GOPR0372_07_01", "test/GOPR0384_11_00")
    ):
        for half in ("blur", "blur_gamma", "sharp"):
            photo(tmp_path / place / half / "000047.png", blurred=half != "sharp", seed=number)
    root = tmp_path
    assert layout_of(root) == layout_of(root / "test") == "gopro"
    assert [path.parent.parent.name for path in photo_folder(root)] == [
        "GOPR0384_11_00",
        "GOPR0372_07_00",
        "GOPR0372_07_01",
    ]
    assert photo_folder(root / "test") == (root / "test/GOPR0384_11_00/sharp/000047.png",)


def test_the_layouts_of_published_blurs_are_told_by_content(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "im05_flit01.mat").write_bytes(b"")
    photo(tmp_path / "two" / "Blurry1_1.png")
    assert layout_of(tmp_path / "one") == "levin"
    assert layout_of(tmp_path / "two") == "koehler"


def no_such(root):
    return root / "nowhere", "no such folder"


def a_file(root):
    return photo(root / "a.png"), "a folder of photos is needed"


def empty(root):
    (root / "notes.txt").write_text("")
    return root, "holds no photos"


def levin(root):
    (root / "im01_ker01.mat").write_bytes(b"")
    return root, "sharp photos is needed"


def koehler(root):
    photo(root / "Blurry1_1.png")
    return root, "sharp photos is needed"


def no_sharp_half(root):
    photo(root / "GOPR01" / "blur" / "1.png")
    return root, "GOPR01: has blur but no folder sharp"


def an_unpaired_photo(root):
    gopro(root)
    (root / "GOPR02" / "blur" / "000002.png").unlink()
    return root, "000002.png is in only one of blur and sharp"


def another_size(root):
    gopro(root)
    photo(root / "GOPR01" / "blur" / "000001.png", side=(40, 48), blurred=True, seed=1)
    return (
        root,
        "GOPR01: blur/000001.png has 48 x 40 px, sharp/000001.png 50 x 40 px; they must be pairs",
    )


def an_extra_photo(root):
    gopro(root)
    photo(root / "GOPR01" / "sharp" / "000003.png")
    return root, "GOPR01: 000003.png is in only one of blur and sharp"


def the_blurred_half(root):
    photo(root / "blur" / "1.png")
    return root / "blur", "blurred half"


def swapped_halves(root):
    return gopro(root, swapped=True), "swapped: blur/000001.png is sharper than sharp/000001.png"


def empty_halves(root):
    (root / "GOPR01" / "sharp").mkdir(parents=True)
    (root / "GOPR01" / "blur").mkdir()
    return root, "hold no photos"


def rsblur_without_sharp(root):
    photo(root / "0001" / "000001" / "real_blur" / "real_blur.png")
    return root, "gt/gt_sharp.png"


REFUSED = (
    no_such,
    a_file,
    empty,
    levin,
    koehler,
    no_sharp_half,
    an_unpaired_photo,
    an_extra_photo,
    another_size,
    the_blurred_half,
    swapped_halves,
    empty_halves,
    rsblur_without_sharp,
)


@pytest.mark.parametrize("made", REFUSED)
def test_folders_without_sharp_photos_or_with_mixed_ones_are_refused(tmp_path, made):
    folder, message = made(tmp_path)
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        photo_folder(folder)
    assert message in str(caught.value)
    assert str(folder) in str(caught.value)


def test_a_still_camera_is_not_taken_for_swapped_halves(tmp_path):
    for half in ("sharp", "blur"):
        photo(tmp_path / "GOPR01" / half / "1.png")
    assert len(photo_folder(tmp_path)) == 1


def test_photos_are_picked_over_the_whole_list(tmp_path):
    photos = [photo(tmp_path / f"{i:02d}.png") for i in range(9)]
    assert [path.stem for path in pick(photos, 3, least_px=40)] == ["00", "03", "06"]
    assert pick(photos, 20, least_px=40) == tuple(photos)
    with pytest.raises(
        ValueError, match=r"00\.png: 50 x 40 px is too small, the protocol needs 41 px"
    ):
        pick(photos, 3, least_px=41)
    photos[3].write_bytes(photos[3].read_bytes()[:200])
    with pytest.raises(ValueError, match=r"03\.png.*damaged"):
        pick(photos, 3, least_px=40)


def test_for_a_photo_that_is_too_small_the_next_is_taken(tmp_path):
    sizes = [(40, 50), (30, 50), (40, 50), (20, 20), (40, 50), (40, 50)]
    photos = []
    for i, size in enumerate(sizes):
        photos.append(tmp_path / f"{i}.png")
        write_image(photos[-1], np.random.default_rng(i).random(size))
    assert [path.stem for path in pick(photos, 2, least_px=40)] == ["0", "4"]
    assert [path.stem for path in pick(photos, 6, least_px=40)] == ["0", "2", "4", "5"]
    assert [path.stem for path in pick(photos[3:], 1, least_px=40)] == ["4"]


def test_a_crop_is_a_part_of_the_photo_and_every_place_may_come(tmp_path):
    path = photo(tmp_path / "a.png")
    whole = read_image(path, gamma="linear")
    corners = set()
    for seed in range(120):
        part = crop(path, 38, np.random.default_rng(seed))
        places = [(row, column) for row in range(3) for column in range(13)]
        (found,) = [
            (r, c) for r, c in places if np.array_equal(whole[r : r + 38, c : c + 38], part)
        ]
        corners.add(found)
    assert {row for row, _ in corners} == {0, 1, 2}
    assert {column for _, column in corners} == set(range(13))
    light = crop(path, 38, np.random.default_rng(0), gamma="srgb")
    assert light.mean() < crop(path, 38, np.random.default_rng(0)).mean()
    with pytest.raises(ValueError, match=r"a\.png: 50 x 40 px is too small"):
        crop(path, 41, np.random.default_rng(0))


def test_anyone_has_photos_large_enough_for_the_protocols():
    photos = bundled_photos()
    assert len(set(photos)) == 10
    assert pick(photos, 10, least_px=256 + 63) == photos
