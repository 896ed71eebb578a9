"""Published sets of real blur: which photos are pairs, in the layouts that are spread, and what is
refused."""

import numpy as np
import pytest

from cep.files.images import write_image
from lab.bench.blind.cases import check_real, real_photos
from lab.bench.blind.plan import blind_plan
from lab.bench.blind.protocol import Protocol
from lab.bench.datasets import RSBLUR_LIST, koehler_pairs, layout_of, photo_folder, rsblur_pairs


def photo(path, *, side=(70, 80)):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, np.random.default_rng(0).random(side))
    return path


def rsblur(root, *, names=("0001/000001", "0001/000022", "0019/003082")):
    """RSBlur.zip: each photo with its averaged frames and their saturation mask beside."""
    for name in names:
        for half in (
            "gt/gt_sharp.png",
            "real_blur/real_blur.png",
            "avg65_img/avg_blur.png",
            "avg65_mask_100/avg_blur.png",
        ):
            photo(root / "RSBlur" / name / half)
    return root


def line(name):
    return f"RSBlur/{name}/gt/gt_sharp.png RSBlur/{name}/real_blur/real_blur.png\n"


def test_rsblurs_pairs_are_found_and_its_list_chooses_among_them(tmp_path):
    root = rsblur(tmp_path)
    assert layout_of(root) == layout_of(root / "RSBlur") == "rsblur"
    pairs = rsblur_pairs(root)
    assert [blurred.parent.parent.name for blurred, _ in pairs] == ["000001", "000022", "003082"]
    for blurred, sharp in pairs:
        assert (blurred.name, sharp.name) == ("real_blur.png", "gt_sharp.png")
        assert blurred.parent.parent == sharp.parent.parent
    (root / RSBLUR_LIST).write_text(line("0019/003082") + line("0001/000022"))
    assert [(one.scene, one.shake) for one in real_photos(root, 9)] == [
        ("0001", "000022"),
        ("0019", "003082"),
    ]
    assert [path.parent.parent.name for path in photo_folder(root)] == ["000022", "003082"]
    assert len(rsblur_pairs(root / "RSBlur")) == 3  # the list lies above


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            line("0001/000022") + line("0007/000222"),
            "names 0007/000222, which is not in this folder",
        ),
        (
            "RSBlur/0001/000022/gt/gt_sharp.png\n",
            "line 1: wanted 0001/000022/gt/gt_sharp.png 0001/000022/real_blur",
        ),
        (line("0001/000022").replace("000022/real", "000001/real"), "line 1: wanted"),
        ("\n", "names no pair"),
    ],
)
def test_a_list_that_does_not_fit_is_one_line(tmp_path, text, message):
    rsblur(tmp_path)
    (tmp_path / RSBLUR_LIST).write_text(text)
    with pytest.raises(ValueError, match=r"^[^\n]*RSBlur_real_test\.txt: [^\n]*$") as caught:
        rsblur_pairs(tmp_path)
    assert message in str(caught.value)


@pytest.mark.parametrize("lost", ["gt/gt_sharp.png", "real_blur/real_blur.png"])
def test_a_lost_half_is_named(tmp_path, lost):
    root = rsblur(tmp_path)
    (root / "RSBlur/0001/000022" / lost).unlink()
    for read in (rsblur_pairs, photo_folder, lambda folder: real_photos(folder, 9)):
        with pytest.raises(ValueError, match=rf"^[^\n]*000022: lacks {lost}; [^\n]*$"):
            read(root)


def test_sharp_photos_without_any_real_blur_are_sharp_photos(tmp_path):
    """GoPro_INTER_ABME, spread with RSBlur, has synthetic blur beside them only."""
    for name in ("gt/gt_sharp.png", "avg_inter_img/avg_blur.png"):
        photo(tmp_path / "GOPR0372_07_00" / "000001" / name)
    assert photo_folder(tmp_path) == (tmp_path / "GOPR0372_07_00/000001/gt/gt_sharp.png",)


def koehler(root, *, frames):
    for image, shake in ((1, 2), (1, 10), (4, 1)):
        photo(root / f"Blurry{image}_{shake}.png")
        for frame in range(1, frames + 1):
            photo(
                root
                / f"Image{image}"
                / f"Kernel{shake}"
                / f"GroundTruth{image}_{shake}_{frame}.png"
            )
    return root


def test_koehlers_photos_come_with_the_frame_in_the_middle(tmp_path):
    pairs = koehler_pairs(koehler(tmp_path, frames=11))
    assert layout_of(tmp_path) == "koehler"
    assert [(blurred.name, sharp.name) for blurred, sharp in pairs] == [
        (f"Blurry{key}.png", f"GroundTruth{key}_6.png") for key in ("1_2", "1_10", "4_1")
    ]
    assert [(one.scene, one.shake) for one in real_photos(tmp_path, 9)] == [
        ("Blurry1", "2"),
        ("Blurry1", "10"),
        ("Blurry4", "1"),
    ]
    plan = blind_plan(Protocol("tiny", 1, 1, crop_px=64), ["pmp"], folder=tmp_path)
    assert {cell.name[0] for cell in plan.cells} == {
        "delta",
        "gaussian",
        "pmp",
    }  # a floor is a photo as it is
    assert {cell.arguments["sharp"].name for cell in plan.cells} == {
        sharp.name for _, sharp in pairs
    }


def test_koehlers_photos_alone_have_no_sharp_ones(tmp_path):
    koehler(tmp_path, frames=0)
    (tmp_path / "GroundTruth1_1.mat").write_bytes(
        b""
    )  # the frames in Matlab's format: no set of Levin's
    assert layout_of(tmp_path) == "koehler"
    assert [sharp for _, sharp in koehler_pairs(tmp_path)] == [None] * 3


def test_frames_of_some_of_koehlers_photos_only_are_refused(tmp_path):
    koehler(tmp_path, frames=1)
    (tmp_path / "Image1/Kernel10/GroundTruth1_10_1.png").unlink()
    with pytest.raises(
        ValueError, match=r"^[^\n]*Blurry1_10\.png has no frames in Image1/Kernel10, others have$"
    ):
        koehler_pairs(tmp_path)


def test_real_photos_are_checked_before_the_work(tmp_path):
    root = rsblur(tmp_path)
    photos = real_photos(root, 9)
    check_real(photos, 70)
    with pytest.raises(
        ValueError, match=r"real_blur\.png: 80 x 70 px is too small, the protocol needs 71 px"
    ):
        check_real(photos, 71)
    photo(photos[2].sharp, side=(72, 80))
    with pytest.raises(ValueError, match=r"real_blur\.png: has the shape .* they must be pairs"):
        check_real(photos, 70)
    levin = tmp_path / "levin"
    levin.mkdir()
    (levin / "im05_flit01.mat").write_text("no matrix")
    with pytest.raises(ValueError, match=r"im05_flit01\.mat: cannot be read as a \.mat file"):
        check_real(real_photos(levin, 9), 70)
