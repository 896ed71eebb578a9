"""Photos for training: a folder, its pack, and crops with every turn and mirror."""

import cv2
import numpy as np
import pytest
import torch

from motdiff.training.photos import crops, load_photos, pack_photos


def smooth_picture(shape, seed):
    """(H, W, 3) uint8 red green blue, soft enough for JPEG to keep."""
    noise = np.random.default_rng(seed).normal(0, 1, (*shape, 3))
    soft = cv2.GaussianBlur(noise, (0, 0), 6)
    return (128 + 50 * soft / soft.std()).clip(0, 255).astype(np.uint8)


def write(path, picture):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture[..., ::-1])


@pytest.fixture
def folder(tmp_path):
    """Three photos, one of them in a subfolder, a small one and a text."""
    home = tmp_path / "photos"
    write(home / "a.png", smooth_picture((70, 90), 0))
    write(home / "b" / "c.PNG", smooth_picture((100, 64), 1))
    write(home / "d.tiff", smooth_picture((64, 64), 2))
    write(home / "small.bmp", smooth_picture((63, 200), 3))
    (home / "notes.txt").write_text("no photo")
    return home


# ---- files


def test_photos_of_a_folder_are_read_in_order_without_small_ones_and_other_files(folder):
    photos = load_photos(folder, least_px=64)
    assert [tuple(photo.shape) for photo in photos] == [(3, 70, 90), (3, 100, 64), (3, 64, 64)]
    for seed, photo in enumerate(photos):
        assert photo.dtype == torch.uint8
        picture = smooth_picture(tuple(photo.shape[1:]), seed)
        np.testing.assert_array_equal(photo.numpy(), picture.transpose(2, 0, 1))


def test_channels_are_red_green_blue(tmp_path):
    red = np.zeros((20, 20, 3), np.uint8)
    red[..., 0] = 200
    write(tmp_path / "red.png", red)
    write(tmp_path / "all" / "red.png", red)
    pack_photos(tmp_path, tmp_path / "pack.zip")
    for source in (tmp_path, tmp_path / "pack.zip"):
        mean = load_photos(source, least_px=20)[0].float().mean(dim=(1, 2))
        torch.testing.assert_close(mean, torch.tensor([200.0, 0.0, 0.0]), atol=2, rtol=0)


def test_a_pack_holds_the_same_photos(folder, tmp_path):
    pack = tmp_path / "photos.zip"
    assert pack_photos(folder, pack, quality=95) == pack.stat().st_size
    originals = load_photos(folder, least_px=64)
    packed = load_photos(str(pack), least_px=64)
    assert len(packed) == 3
    for original, copy in zip(originals, packed, strict=True):
        assert copy.shape == original.shape
        assert float((copy.float() - original.float()).abs().mean()) < 1.5
    before = pack.read_bytes()
    pack_photos(folder, pack, quality=30)
    assert len(pack.read_bytes()) < len(before)


def test_large_photos_are_shrunk_by_their_short_side(folder, tmp_path):
    shapes = [tuple(photo.shape) for photo in load_photos(folder, least_px=32, most_px=35)]
    assert shapes == [(3, 35, 45), (3, 55, 35), (3, 35, 35), (3, 35, 111)]
    pack_photos(folder, tmp_path / "small.zip", most_px=35)
    assert [
        tuple(photo.shape) for photo in load_photos(tmp_path / "small.zip", least_px=35)
    ] == shapes
    half = load_photos(folder, least_px=32, most_px=32)[
        2
    ].float()  # 64 px: every pixel is the mean of four
    whole = torch.from_numpy(smooth_picture((64, 64), 2).transpose(2, 0, 1).copy()).float()
    torch.testing.assert_close(half, torch.nn.functional.avg_pool2d(whole, 2), atol=1, rtol=0)


def test_what_holds_no_photos_is_refused(folder, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.zip").write_text("no zip")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "torn.png").write_bytes((folder / "a.png").read_bytes()[:20])
    (tmp_path / "hollow").mkdir()
    (tmp_path / "hollow" / "zero.jpg").touch()
    for call, said in (
        (
            lambda: load_photos(folder, least_px=101),
            r"photos: holds no photo of at least 101 x 101 px",
        ),
        (
            lambda: load_photos(folder, least_px=64, most_px=50),
            r"^most_px: must be at least least_px = 64, got 50$",
        ),
        (lambda: load_photos(tmp_path / "empty", least_px=1), r"empty: holds no photo"),
        (
            lambda: load_photos(tmp_path / "nowhere", least_px=1),
            r"nowhere: must be a folder of photos or a .zip pack",
        ),
        (lambda: load_photos(tmp_path / "text.zip", least_px=1), r"text.zip: must be a folder"),
        (
            lambda: load_photos(tmp_path / "bad", least_px=1),
            r"torn.png: cannot be read as a photo",
        ),
        (
            lambda: load_photos(tmp_path / "hollow", least_px=1),
            r"zero.jpg: cannot be read as a photo",
        ),
        (
            lambda: pack_photos(tmp_path / "empty", tmp_path / "new.zip"),
            r"empty: holds no photo to pack",
        ),
    ):
        with pytest.raises(ValueError, match=said):
            call()
    assert not (tmp_path / "new.zip").exists()


# ---- crops


def cut(photos, *, count, size, seed=0):
    return crops(photos, count=count, size=size, generator=torch.Generator().manual_seed(seed))


def distinct(maps):
    return {bytes((255 * one).round().to(torch.uint8).contiguous().numpy()) for one in maps}


def test_crops_of_a_photo_as_large_show_the_8_symmetries():
    photo = torch.randint(
        0, 256, (3, 9, 9), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )
    whole = photo.float() / 255
    turned = [torch.rot90(whole, quarter, (1, 2)) for quarter in range(4)]
    everything = distinct(turned) | distinct(one.transpose(1, 2) for one in turned)
    assert len(everything) == 8
    assert distinct(cut([photo], count=100, size=9)) == everything


def test_crops_come_from_everywhere_in_every_photo():
    codes = torch.arange(1, 1 + 2 * 12, dtype=torch.uint8).view(2, 1, 3, 4).expand(2, 3, 3, 4)
    found = cut(list(codes), count=400, size=2)
    smallest = (
        (255 * found[:, 0].amin(dim=(1, 2))).round().int()
    )  # the upper left pixel, however turned
    places = {
        int(codes[photo, 0, row, column])
        for photo in (0, 1)
        for row in (0, 1)
        for column in (0, 1, 2)
    }
    assert set(smallest.tolist()) == places
    counts = smallest.bincount()
    assert int(counts[counts > 0].min()) > 400 / 12 / 3


def test_crops_repeat_with_the_seed():
    generator = torch.Generator().manual_seed(1)
    photos = [
        torch.randint(0, 256, (3, 40, 50), dtype=torch.uint8, generator=generator)
        for _ in range(3)
    ]
    first = cut(photos, count=6, size=16, seed=4)
    assert first.shape == (6, 3, 16, 16)
    assert first.dtype == torch.float32
    assert 0 <= float(first.min()) <= float(first.max()) <= 1
    assert torch.equal(first, cut(photos, count=6, size=16, seed=4))
    assert not torch.equal(first, cut(photos, count=6, size=16, seed=5))
