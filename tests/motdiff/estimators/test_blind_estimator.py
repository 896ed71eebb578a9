"""Blind estimation in photos of any size, with a search whose answers are known: crops, halving,
what is told."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator, without_lights
from motdiff.metrics import mnc_subpixel
from motdiff.network.path_drawing import PathOrder
from motdiff.photo_values import exposure_gain
from motdiff.psf_frame import without_faint_parts
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

KERNEL_PX = 39
RNG = np.random.default_rng(0)
SCENE = 0.5 * np.kron(RNG.random((16, 16)), np.ones((12, 12)))
LIGHTS = np.zeros(SCENE.shape, bool)
LIGHTS[40:43, 60:80] = True
PHOTO = np.where(LIGHTS, 1.0, SCENE)


def line(length_px=9, *, side=KERNEL_PX, angle_rad=0.0):
    """Kernel of a straight, even motion, exactly 0 elsewhere."""
    return Trajectory.straight(length_px, angle_rad=angle_rad).psf(side)


class FakeSearch(BlindEstimator):
    """Finds a given kernel with a given confidence, the next pair at each scale; notes what it is
    asked.

    The last pair goes on. ``singles`` are the kernels of single crops.
    """

    method = "fake"
    largest_px = KERNEL_PX
    smallest_px = 48

    def __init__(self, *answers, singles=None, warnings=(), others=(), **options):
        super().__init__(**options)
        self.answers = list(answers or [(line(), 0.9)])
        self.singles = singles
        self.warnings = warnings
        self.others = list(others)
        self.seen = []
        self.alone = []

    def search(self, crops, progress, halved=None):
        kernel, confidence = self.answers[min(len(self.seen), len(self.answers) - 1)]
        self.seen.append(crops)
        kernels, probabilities = zip(*self.others, (kernel, confidence), strict=True)
        best = len(self.others)
        return FoundKernels(
            kernels,
            np.array(probabilities),
            best,
            {"answer": len(self.seen)},
            tuple(self.warnings),
        )

    def refine(self, crops, kernel):
        return kernel

    def single(self, crops, found, progress):
        self.alone.append((crops, found))
        return self.singles or [found.best_kernel] * len(crops)


@pytest.fixture(autouse=True)
def undoubted(monkeypatch):
    """The kernels here are not the blur of the photos: the photo's doubts are tests of their own,
    test_doubts.py."""
    asked = []

    def kept(estimate, crops, **given):
        asked.append((crops, given))
        return estimate

    monkeypatch.setattr("motdiff.estimators.blind_estimator.doubted", kept)
    return asked


def noise(*shape, seed=0):
    return np.random.default_rng(seed).random(shape)


def found_in(photo, search=None):
    search = search or FakeSearch()
    return search.estimate(photo), search


# ---- threads


def test_the_search_has_one_thread_a_call_and_the_process_its_own_afterwards(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    seen = []

    class Noting(FakeSearch):
        def search(self, crops, progress, halved=None):
            seen.append(threads())
            return super().search(crops, progress)

    def threads():
        return torch.get_num_threads(), {
            pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"
        }

    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        found_in(noise(100, 100), Noting())
        ((of_torch, of_blas),) = seen
        assert of_torch == 1
        assert of_blas <= {1}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


# ---- progress


def test_each_photo_is_told_of_from_the_start_to_the_end():
    class Telling(FakeSearch):
        def search(self, crops, progress, halved=None):
            progress.expect(2.0)
            progress.spend(1.0)
            return super().search(crops, progress)

    shares = []
    search = Telling((LONG, UNSURE), (line(), SURE), progress=shares.append)
    search.estimate(noise(300, 300))
    assert shares == [0.5, 0.75, 1.0]  # at half size as well: the half of what is left
    shares.clear()
    search.estimate(noise(100, 100))
    assert shares == [0.5, 1.0]


def test_several_photos_are_told_of_as_one_work():
    class Telling(FakeSearch):
        def search(self, crops, progress, halved=None):
            progress.expect(2.0)
            progress.spend(1.0)
            return super().search(crops, progress)

    shares = []
    Telling(progress=shares.append).estimate_from([noise(100, 100), noise(100, 100, seed=1)])
    # a quarter each of the work, and half of it together
    np.testing.assert_allclose(shares, [0.125, 0.25, 0.375, 0.5, 0.75, 0.999, 1.0])


# ---- several photos


def test_several_photos_are_searched_alone_and_together():
    photos = [noise(100, 90), noise(100, 90, seed=1), noise(80, 100, seed=2)]
    search = FakeSearch()
    estimate = search.estimate_from(photos)
    assert [crops.shape for crops in search.seen] == [
        (1, 100, 90),
        (1, 100, 90),
        (1, 80, 100),
        (3, 80, 90),
    ]
    assert search.alone == []  # a crop of each photo has been searched alone
    figures = estimate.details
    assert (figures["photos"], figures["seen_in"], figures["left_out"]) == (3, 3, [])
    assert figures["repeatability"] == pytest.approx([1, 1, 1])
    assert figures["repeatability_px"] == pytest.approx([0, 0, 0], abs=1e-6)


class Correcting(FakeSearch):
    """Turns every kernel found, once."""

    def corrected(self, crops, found, progress):
        self.corrected_crops = [*getattr(self, "corrected_crops", []), crops.shape]
        return replace(found, kernels=tuple(np.rot90(kernel) for kernel in found.kernels))


def test_the_result_is_corrected_once_on_the_crops_of_all_photos():
    photos = [noise(100, 100), noise(100, 90, seed=1), noise(80, 100, seed=2)]
    plain = FakeSearch().estimate_from(photos)
    corrected = (search := Correcting()).estimate_from(photos)
    assert search.corrected_crops == [(3, 80, 90)]
    assert mnc_subpixel(corrected.psf[1:, 1:], np.rot90(plain.psf[1:, 1:])) > 0.99
    assert mnc_subpixel(corrected.psf, plain.psf) < 0.9
    for name in (
        "repeatability",
        "repeatability_px",
        "seen_in",
    ):  # of kernels that no correction has touched
        assert corrected.details[name] == plain.details[name]


def test_a_photo_at_half_size_is_corrected_there():
    search = Correcting((LONG, UNSURE), (line(), SURE))
    search.estimate(noise(300, 300))
    assert search.corrected_crops == [(1, 150, 150)]


def test_many_large_photos_have_fewer_crops_each():
    search = FakeSearch()
    search.estimate_from([noise(330, 600, seed=i) for i in range(6)])
    assert [len(crops) for crops in search.seen] == [2] * 6 + [12]


def test_a_motion_that_outgrows_the_search_is_tried_at_half_size_in_all_photos():
    half = line(18)
    search = FakeSearch(*[(LONG, UNSURE)] * 3, (half, SURE))
    estimate = search.estimate_from([noise(300, 300), noise(300, 300, seed=1)])
    assert [crops.shape[1] for crops in search.seen] == [300] * 3 + [150] * 3
    assert estimate.best.length_px == pytest.approx(36, rel=0.06)
    assert estimate.details["repeatability_px"] == pytest.approx([0, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (noise(40, 90), r"^photo 2: needs at least 48 x 48 px"),
        (np.full((100, 90), 0.3), "^photo 2: is constant"),
        (noise(49, 49), "^photo 2: is too small to be searched with the others"),
    ],
)
def test_a_photo_that_cannot_be_searched_is_named_by_its_number(second, said):
    with pytest.raises(ValueError, match=said):
        FakeSearch().estimate_from([noise(100, 110), second])


# ---- crops


@pytest.mark.parametrize("shape", [(48, 48), (64, 320), (256, 256), (300, 300), (320, 320)])
def test_small_photos_are_searched_whole(shape):
    photo = noise(*shape)
    estimate, search = found_in(photo)
    (crops,) = search.seen
    np.testing.assert_array_equal(crops, photo[None])
    assert estimate.details["crops"] == 1
    assert search.alone == []


@pytest.mark.parametrize(
    ("shape", "most", "expected"),
    [
        ((321, 300), 3, (1, 256, 256)),
        ((500, 700), 3, (3, 256, 256)),
        ((500, 700), 2, (2, 256, 256)),
        ((500, 700), 1, (1, 256, 256)),
        ((100, 600), 3, (3, 100, 100)),
        ((60, 330), 3, (3, 60, 60)),
    ],
)
def test_large_photos_are_searched_in_square_crops(shape, most, expected):
    photo = noise(*shape)
    estimate, search = found_in(photo, FakeSearch(crops=most))
    (crops,) = search.seen
    assert crops.shape == expected
    assert estimate.details["crops"] == expected[0]
    places = np.lib.stride_tricks.sliding_window_view(photo, expected[1:])
    for crop in crops:
        corners = np.argwhere(places[:, :, 0, 0] == crop[0, 0])
        assert any(np.array_equal(places[r, c], crop) for r, c in corners)
    assert len({crop.tobytes() for crop in crops}) == len(crops)


def test_colours_are_searched_on_their_luminance():
    photo = noise(70, 80, 3)
    _, search = found_in(photo)
    np.testing.assert_allclose(search.seen[0][0], photo.mean(axis=2))


def test_the_search_sees_the_same_photo_whatever_its_exposure():
    photo = noise(64, 64)
    photo *= 0.95 / photo.max()
    for dimming in (1, 3, 16, 500):
        np.testing.assert_allclose(found_in(photo / dimming)[1].seen[0][0], photo, rtol=1e-12)
    bright = photo / photo.max()
    np.testing.assert_array_equal(found_in(bright)[1].seen[0][0], bright)


def test_crops_without_texture_are_left_out():
    """A burnt-out sky has no noise either: its spectrum is 0, and nothing can be said of it."""
    photo = np.full((500, 700), 1.0)
    photo[:200, :200] = noise(200, 200)
    estimate, search = found_in(photo)
    assert search.seen[0].shape == (2, 256, 256)  # one whole, one that overlaps it a little
    assert (np.ptp(search.seen[0], axis=(1, 2)) > 0).all()
    assert estimate.details["crops"] == 2


def test_every_crop_shares_in_the_check_of_one_blur():
    _, search = found_in(noise(500, 700))
    ((crops, found),) = search.alone
    np.testing.assert_array_equal(crops, search.seen[0])
    assert found.details == {"answer": 1}


# ---- halving


LONG = line(36)  # more than 0.8 of the frame
UNSURE = 0.55
SURE = 0.7
SURER = 0.8


def scales(photo_px, *answers):
    estimate, search = found_in(noise(photo_px, photo_px), FakeSearch(*answers))
    return estimate, [crops.shape for crops in search.seen]


def test_a_blur_that_fits_is_not_tried_again():
    estimate, seen = scales(300, (line(28), SURE))
    assert len(seen) == 1
    assert estimate.details["scale"] == 1
    assert estimate.warnings == ()


def test_a_blur_that_outgrows_the_search_is_tried_at_half_size():
    half = line(18)
    estimate, seen = scales(300, (LONG, UNSURE), (half, SURE))
    assert seen == [(1, 300, 300), (1, 150, 150)]
    assert estimate.details["scale"] == 0.5
    assert estimate.details["answer"] == 2
    assert estimate.confidence == SURE
    assert estimate.warnings == (
        "the motion was estimated on the photo at 1/2 of its size, where it shows better",
    )
    assert estimate.psf_warnings == estimate.warnings
    assert estimate.trajectories[0].length_px == pytest.approx(36, rel=0.06)
    assert mnc_subpixel(estimate.psf, line(36, side=65)) > 0.97
    assert estimate.psf.shape == (64, 64)
    assert estimate.psf.sum() == pytest.approx(1)


def test_a_veil_over_the_whole_frame_counts_as_a_blur_that_outgrows_it():
    """What is off the path must be exactly 0: the search sees to it."""
    veil = line(9) + 1e-6
    _, seen = scales(300, (veil / veil.sum(), UNSURE), (line(5), SURE))
    assert len(seen) == 2


@pytest.mark.parametrize(
    ("first", "second", "halved"),
    [
        (0.6, 0.66, True),
        (0.6, 0.64, False),
        (0.2, 0.51, True),
        (0.2, 0.49, False),
        (0.47, 0.51, False),
    ],
)
def test_half_size_is_taken_only_where_it_is_clearly_better(first, second, halved):
    estimate, seen = scales(600, (LONG, first), (line(18), second))
    assert len(seen) == 2
    assert estimate.details["scale"] == (0.5 if halved else 1)
    assert estimate.confidence == (second if halved else first)


def test_a_photo_is_halved_twice_at_most():
    estimate, seen = scales(800, (LONG, 0.55), (LONG, 0.65), (LONG, 0.75), (line(5), 0.95))
    assert len(seen) == 3
    assert estimate.details["scale"] == 0.25
    assert estimate.trajectories[0].length_px == pytest.approx(4 * 36, rel=0.06)
    assert estimate.psf.shape[0] == estimate.trajectories[0].frame_size() > 64
    assert "1/4 of its size" in estimate.warnings[-1]


def test_twice_as_coarse_stops_where_it_no_longer_helps():
    estimate, seen = scales(400, (LONG, 0.55), (LONG, 0.65), (line(9), 0.66))
    assert len(seen) == 3
    assert estimate.details["scale"] == 0.5


@pytest.mark.parametrize(
    ("side", "confidence", "tries"), [(512, 0.3, 2), (511, 0.3, 1), (512, 0.5, 1)]
)
def test_a_lost_blur_is_looked_for_at_half_size_where_pixels_are_to_spare(side, confidence, tries):
    _, seen = scales(side, (line(9), confidence))
    assert len(seen) == tries


@pytest.mark.parametrize(("side", "tries"), [(191, 1), (192, 2), (382, 2), (384, 3)])
def test_small_photos_are_not_halved(side, tries):
    _, seen = scales(side, (LONG, 0.55), (LONG, 0.65), (LONG, 0.75), (LONG, 0.85))
    assert len(seen) == tries


def test_halved_photos_are_means_of_pixels():
    photo = noise(300, 260)
    _, search = found_in(photo, FakeSearch((LONG, UNSURE), (line(), SURE)))
    np.testing.assert_allclose(
        search.seen[1][0], photo.reshape(150, 2, 130, 2).mean(axis=(1, 3)), atol=1e-12
    )


# ---- what is told


def test_warnings_come_in_the_order_of_what_was_done(monkeypatch):
    kernels = [line(), line(angle_rad=1.5)]
    asked = []

    def judged(crops, own, shared):
        asked.append((crops, own, shared))
        return "uneven"

    monkeypatch.setattr("motdiff.estimators.blind_estimator.uneven_blur_warning", judged)
    search = FakeSearch(
        (LONG, 0.1), (line(), 0.6), singles=kernels, warnings=("the search says this",)
    )
    estimate, _ = found_in(noise(700, 900), search)
    said, uneven, halved = estimate.warnings
    assert said == "the search says this"
    assert uneven == "uneven"
    assert "1/2 of its size" in halved
    # the crops of the size that counts, and once
    ((crops, own, shared),) = asked
    np.testing.assert_array_equal(crops, search.seen[-1])
    assert own is kernels
    np.testing.assert_array_equal(shared, line())


def test_a_lost_estimate_is_said_to_be_lost():
    estimate, _ = found_in(noise(100, 100), FakeSearch((line(), 0.49)))
    (lost,) = estimate.warnings
    assert lost.startswith("the blind estimate is probably lost (confidence 0.49)")
    assert found_in(noise(100, 100), FakeSearch((line(), 0.5)))[0].warnings == ()


@pytest.fixture
def drawing(monkeypatch):
    """Let the model draw orders in time with their chances; returns what it was asked."""
    asked = []

    def draw_these(*orders, right=0.7):
        drawn = tuple(PathOrder(path, chance, right) for path, chance in orders)

        def draw(_denoiser, _kernel, *, count, rng):
            asked.append((count, rng.random()))
            return SimpleNamespace(orders=lambda: drawn)

        monkeypatch.setattr(
            "motdiff.estimators.description.plain_trajectory", lambda *_, **__: None
        )
        monkeypatch.setattr("motdiff.network.path_drawing.draw_paths", draw)
        return asked

    return draw_these


TWO_ORDERS = (Trajectory.straight(12.0), Trajectory.straight(12.0, angle_rad=1.0))


@pytest.mark.parametrize("factor", [1, 2])
def test_the_orders_drawn_share_the_kernel_s_weight(drawing, factor):
    first, second = TWO_ORDERS
    drawing((first, 0.75), (second, 0.25), right=0.6)
    up = line(9, angle_rad=np.pi / 2)
    search = FakeSearch((line(13), 0.8), others=[(up, 0.3)])
    side = 100
    if factor > 1:
        side = 300
        search = FakeSearch((LONG, 0.1), (line(13), 0.8))
    estimate, _ = found_in(noise(side, side), search)
    np.testing.assert_allclose(estimate.best.xy, factor * first.xy)
    np.testing.assert_allclose(estimate.trajectories[-1].xy, factor * second.xy)
    weights = np.array([0.6, 0.2] if factor > 1 else [0.6, 0.3 * 0.75, 0.2])
    assert estimate.weights == pytest.approx(weights / weights.sum())
    assert estimate.details["path_confidence"] == pytest.approx(0.8 * 0.6)
    assert estimate.warnings == () or factor > 1


def test_no_alternative_outweighs_the_best_path_for_its_own_order_being_known(drawing):
    """With three equally likely orders; the other kernel has as many, though none was drawn."""
    paths = [Trajectory.straight(12.0, angle_rad=angle) for angle in (0.0, 1.0, 2.0)]
    drawing(*((path, 1 / 3) for path in paths))
    search = FakeSearch((line(13), 0.8), others=[(line(9, angle_rad=np.pi / 2), 0.6)])
    estimate, _ = found_in(noise(100, 100), search)
    assert estimate.weights[0] == max(estimate.weights)


def test_an_order_in_doubt_is_said_unless_the_whole_estimate_is_lost(drawing):
    first, second = TWO_ORDERS
    drawing((first, 0.9), (second, 0.1), right=0.4)
    estimate, _ = found_in(noise(100, 100), FakeSearch((line(13), 0.98)))
    (said,) = estimate.warnings
    assert "does not tell the order in time" in said
    assert "method gyro" in said
    assert estimate.confidence == 0.98
    assert said not in estimate.psf_warnings
    (lost,) = found_in(noise(100, 100), FakeSearch((line(13), 0.4)))[0].warnings
    assert lost.startswith("the blind estimate is probably lost")


def test_the_seed_is_that_of_the_drawn_paths(drawing):
    asked = drawing((Trajectory.straight(12.0), 1.0))
    for seed in (0, 0, 1):
        found_in(noise(100, 100), FakeSearch(seed=seed))
    assert asked[0] == asked[1] != asked[2]


def test_one_blur_in_all_crops_is_no_warning():
    estimate, search = found_in(noise(500, 700))
    assert len(search.alone) == 1
    assert estimate.warnings == ()


def test_distinct_motions_follow_as_alternatives_likeliest_first():
    up = line(9, angle_rad=np.pi / 2)
    slanted = line(15, angle_rad=0.9)
    alike = line(10)
    fourth = line(30, angle_rad=-0.6)
    search = FakeSearch(
        (line(9), 0.6), others=[(fourth, 0.1), (up, 0.3), (alike, 0.65), (slanted, 0.7)]
    )
    estimate, _ = found_in(noise(100, 100), search)
    assert estimate.confidence == 0.6  # of the chosen one, which need not be the likeliest
    assert estimate.weights == pytest.approx(np.array([0.6, 0.7, 0.3]) / 1.6)
    angles = [np.arctan2(*np.ptp(motion.xy, axis=0)[::-1]) for motion in estimate.trajectories]
    assert angles == pytest.approx([0, 0.9, np.pi / 2], abs=0.1)
    assert [motion.length_px for motion in estimate.trajectories] == pytest.approx(
        [9, 15, 9], abs=1.5
    )
    assert {motion.direction for motion in estimate.trajectories} == {"unknown"}


def test_faint_parts_are_in_the_psf_but_not_in_the_path():
    branch = line(9) + 0.03 * np.roll(line(9, angle_rad=np.pi / 2), 5, axis=0)
    branch /= branch.sum()
    kept = without_faint_parts(branch)
    np.testing.assert_array_equal(kept > 0, branch >= 0.05 * branch.max())
    assert kept.sum() == pytest.approx(1)
    estimate, _ = found_in(noise(100, 100), FakeSearch((branch, 0.9)))
    plain, _ = found_in(noise(100, 100))
    assert estimate.psf[32 + 8, 32] > 0
    assert np.ptp(estimate.trajectories[0].xy[:, 1]) < 1
    assert estimate.trajectories[0].length_px == pytest.approx(
        plain.trajectories[0].length_px, abs=0.2
    )


def test_specks_are_not_part_of_the_path():
    speck = line(9)
    speck[4, 4] = 0.3 * speck.max()
    np.testing.assert_allclose(
        without_faint_parts(speck), np.where(speck < 0.05 * speck.max(), 0, line(9)), atol=0.01
    )
    assert without_faint_parts(speck)[4, 4] == 0
    two = line(9) + np.roll(line(9), 12, axis=0)  # as bright as each other: both are the motion's
    np.testing.assert_array_equal(without_faint_parts(two) > 0, two >= 0.05 * two.max())
    speck /= speck.sum()
    estimate, _ = found_in(noise(100, 100), FakeSearch((speck, 0.9)))
    plain, _ = found_in(noise(100, 100))
    assert estimate.psf[32 - 15, 32 - 15] > 0
    assert estimate.trajectories[0].length_px == pytest.approx(
        plain.trajectories[0].length_px, abs=0.2
    )


@pytest.mark.parametrize(("side", "frame"), [(29, 64), (63, 64), (65, 66), (71, 72)])
def test_kernels_are_framed_with_their_centre_at_half_the_frame(side, frame):
    kernel = np.zeros((side, side))
    kernel[side // 2 - 3, side // 2 + 5] = 1
    kernel[side // 2 - 3, side // 2 + 6] = 1
    estimate, _ = found_in(noise(100, 100), FakeSearch((kernel / 2, 0.9)))
    assert estimate.psf.shape == (frame, frame)
    assert np.argwhere(estimate.psf).tolist() == [
        [frame // 2 - 3, frame // 2 + 5],
        [frame // 2 - 3, frame // 2 + 6],
    ]
    assert estimate.psf.max() == 0.5


def test_what_it_returns_keeps_the_conventions():
    estimate, _ = found_in(noise(100, 100))
    assert estimate.method == "fake"
    assert estimate.weights == (1.0,)
    assert estimate.details == {
        "crops": 1,
        "scale": 1.0,
        "answer": 1,
        "trajectory_psf_mnc": pytest.approx(1, abs=0.01),
        "psf_confidence": 0.9,
        "path_confidence": pytest.approx(0.9 * 0.9),
    }
    scene = noise(60, 60)
    blurred = blur_valid(scene, estimate.psf[16:49, 16:49])  # a true convolution about the middle
    np.testing.assert_allclose(blurred, blur_valid(scene, line(9, side=33)), atol=1e-9)


def test_the_estimate_is_doubted_on_the_photo_at_full_size(undoubted):
    found_in(noise(300, 300), FakeSearch((LONG, UNSURE), (line(18), SURE)))
    ((crops, given),) = undoubted
    assert crops.shape == (1, 300, 300)
    assert given == {"uneven": False, "outgrown": False}
    found_in(noise(100, 100), FakeSearch((LONG, SURE)))
    assert undoubted[-1][1]["outgrown"]


def test_a_plain_path_is_less_sure_than_its_psf():
    kernel = Trajectory.from_samples([[0, 0], [10, 0], [20, 2]]).psf(KERNEL_PX)
    estimate, _ = found_in(noise(100, 100), FakeSearch((kernel, 0.8)))
    assert estimate.details["psf_confidence"] == estimate.confidence == 0.8
    assert estimate.details["path_confidence"] == pytest.approx(0.8 * 0.9)


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (
            np.full((100, 100), 0.4),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (
            np.full((100, 100, 3), [0.1, 0.5, 0.3]),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (noise(47, 300), "photo: needs at least 48 x 48 px, got 300 x 47"),
        (np.where(np.eye(100) > 0, np.nan, 0.5), "photo: must be finite, found NaN or infinity"),
        (np.where(np.eye(100) > 0, np.inf, 0.5), "photo: must be finite, found NaN or infinity"),
        (np.zeros(100), "photo: must be (H, W) or (H, W, C), got shape (100,)"),
        (
            np.repeat(np.arange(700)[None] >= 690, 700, axis=0) * 0.5,
            (
                "photo: has edges of one direction at most; motion shows only where the scene has"
                " texture"
            ),
        ),
    ],
)
def test_unusable_photos_are_refused_in_one_line(photo, message):
    search = FakeSearch(crops=1)
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the whole message is compared
        found_in(photo, search)
    assert str(caught.value) == message
    assert search.seen == []


def test_the_search_says_how_small_a_photo_may_be():
    search = FakeSearch()
    search.smallest_px = 64
    with pytest.raises(ValueError, match=r"^photo: needs at least 64 x 64 px, got 63 x 80$"):
        found_in(noise(80, 63), search)
    found_in(noise(80, 64), search)
    assert len(search.seen) == 1


def test_found_is_as_sure_as_its_choice():
    found = FoundKernels((line(), line(5)), np.array([0.2, 0.7]), 0)
    assert found.confidence == 0.2
    assert found.details == {}
    assert found.warnings == ()


def test_a_ramp_is_continued_across_lights():
    y, x = np.indices((60, 70))
    ramp = 0.2 + 0.004 * y + 0.002 * x
    clipped = np.zeros(ramp.shape, bool)
    clipped[25:30, 20:40] = True
    np.testing.assert_allclose(
        without_lights(np.where(clipped, 1.0, ramp), clipped), ramp, atol=1e-12
    )


def test_values_under_lights_do_not_matter_and_others_stay():
    spanned = without_lights(PHOTO, LIGHTS)
    np.testing.assert_array_equal(without_lights(np.where(LIGHTS, 7.0, SCENE), LIGHTS), spanned)
    assert spanned.max() <= SCENE.max()
    far = np.ones(SCENE.shape, bool)
    far[30:53, 50:90] = False
    np.testing.assert_array_equal(spanned[far], PHOTO[far])


def test_a_photo_with_lights_nowhere_or_all_over_is_left():
    assert without_lights(SCENE, np.zeros(SCENE.shape, bool)) is SCENE
    assert without_lights(SCENE, np.ones(SCENE.shape, bool)) is SCENE
    scattered = np.zeros(SCENE.shape, bool)
    scattered[::12, ::12] = True
    assert without_lights(SCENE, scattered) is SCENE


def test_a_light_at_the_border_is_spanned():
    corner = np.zeros(SCENE.shape, bool)
    corner[:3, :5] = True
    spanned = without_lights(np.where(corner, 1.0, SCENE), corner)
    assert np.isfinite(spanned).all()
    assert spanned.max() <= SCENE.max()


def test_a_blur_lost_beside_lights_is_searched_without_them():
    search = FakeSearch((line(9), 0.2), (line(15), 0.8))
    found = search.estimate(PHOTO)
    assert len(search.seen) == 2
    np.testing.assert_array_equal(search.seen[0][0], PHOTO)
    np.testing.assert_array_equal(search.seen[1][0], without_lights(PHOTO, LIGHTS))
    assert found.details["lights_left_out"] is True
    assert found.details["psf_confidence"] == pytest.approx(0.8)


def test_a_light_clipped_in_one_colour_counts():
    colours = np.stack([PHOTO, SCENE, SCENE], axis=2)
    search = FakeSearch((line(9), 0.2), (line(15), 0.8))
    search.estimate(colours)
    grey = colours.mean(axis=2)
    np.testing.assert_array_equal(search.seen[1][0], without_lights(grey, LIGHTS))


def test_the_likelier_of_both_searches_is_kept():
    search = FakeSearch((line(9), 0.3), (line(15), 0.2))
    found = search.estimate(PHOTO)
    assert len(search.seen) == 2
    assert "lights_left_out" not in found.details
    assert found.details["psf_confidence"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("photo", "confidence"),
    [(SCENE, 0.2), (PHOTO, 0.9), (np.where(np.indices(SCENE.shape)[0] < 40, 1.0, SCENE), 0.2)],
    ids=["nothing clipped", "not lost", "a clipped sky"],
)
def test_otherwise_one_search_of_the_photo_as_it_is(photo, confidence):
    search = FakeSearch((line(9), confidence), (line(15), 0.8))
    found = search.estimate(photo)
    assert len(search.seen) == 1
    np.testing.assert_array_equal(search.seen[0][0], exposure_gain(photo) * photo)
    assert "lights_left_out" not in found.details
