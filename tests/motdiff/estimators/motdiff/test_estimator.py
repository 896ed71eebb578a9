"""The estimator: two corrected searches, one at half the size where they differ, and the photo's
choice among them."""

import numpy as np
import pytest
from leaf_photos import leaves, photo_of
from skimage import data

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge, kernel_score
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.motdiff import estimator as module
from motdiff.estimators.motdiff.estimator import (
    MotDiffEstimator,
    enlarged_kernel,
    in_odd_frames,
    probability_good,
)
from motdiff.estimators.pmp.estimator import STARTS
from motdiff.metrics import mnc_subpixel
from motdiff.network.correction import corrected_kernel
from motdiff.network.path_drawing import PathOrder
from motdiff.network.physics_maps import QUICK_STARTS
from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.progress import Progress
from motdiff.simulate import photograph
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.weights import CORRECTION_WEIGHTS, PATH_WEIGHTS, load_correction

STRAIGHT = Trajectory.straight(15.0, angle_rad=0.5)
BENT = Trajectory.from_samples([[0, 0], [9, 2], [17, 8], [22, 17]])
LOST = (Trajectory.straight(9.0, angle_rad=2.2), Trajectory.straight(20.0, angle_rad=1.4))


@pytest.fixture(autouse=True)
def in_order():
    """One job after the other: the searches below note what they are asked."""
    with one_thread():
        yield


def camera_photo(motion, *, side=256):
    rng = np.random.default_rng(0)
    scene = (data.camera()[60 : 60 + side + 64, 100 : 100 + side + 64] / 255) ** 2.2
    return photograph(scene, motion, rng=rng, read_sigma=0.005)[:side, :side]


@pytest.fixture(scope="module")
def shaken():
    return photo_of(STRAIGHT)


class Searches:
    """Searches with known results, by the side of the photo; notes the shapes of the crops."""

    def __init__(self, motions):
        self.motions = motions
        self.shapes = []

    def __call__(self, *, starts):
        assert starts == STARTS[:2]
        return self

    def kernels(self, crops, *, progress):
        self.shapes.append(crops.shape)
        progress.spend(2.0)
        return [motion.psf(63) for motion in self.motions.get(crops.shape[-1], LOST)]


@pytest.fixture
def finding(monkeypatch):
    """Let searches in photos of these sides find these motions, in others wrong ones."""

    def searches(motions):
        made = Searches(motions)
        monkeypatch.setattr(module, "PmpEstimator", made)
        return made

    return searches


@pytest.fixture
def uncorrected(monkeypatch):
    monkeypatch.setattr(
        module, "corrected_kernel", lambda _network, _crops, kernel, *_, **__: kernel
    )


def no_half():
    pytest.fail("searched the photo at half its size")


# ---- what is searched, and which kernel is chosen


def test_where_two_corrected_searches_agree_nothing_more_is_searched(finding, shaken):
    finding({shaken.shape[1]: (STRAIGHT, STRAIGHT)})
    estimator = MotDiffEstimator()
    candidates = estimator.search(shaken[None], Progress(), no_half)
    better = estimator.corrected(shaken[None], candidates, Progress())
    assert len(candidates.kernels) == 2
    assert candidates.details["agreement"] > 0.9
    assert mnc_subpixel(candidates.kernels[0], STRAIGHT.psf(63)) > 0.999  # as searched
    pair = [STRAIGHT.psf(63)] * 2
    sigma = shared_sigma(shaken[None])
    expected = corrected_kernel(load_correction(), shaken[None], pair[1], pair[:1], sigma=sigma)
    np.testing.assert_array_equal(candidates.corrected[1], expected)
    assert better.confidence == candidates.confidence > 0.9


def test_where_they_differ_the_photo_chooses_among_three(finding, uncorrected):
    """The right kernel comes from the photo at half its size."""
    photo = camera_photo(BENT)
    half = BENT.scaled(0.5)
    searches = finding({256: LOST, 128: (half, half)})
    candidates = MotDiffEstimator().search(photo[None], Progress(), lambda: photo[None, ::2, ::2])
    assert searches.shapes == [(1, 256, 256), (1, 128, 128)]
    assert candidates.origins == ("search", "search", "search at half the size")
    scores = kernel_score(Judge(photo[None]).evidence(list(candidates.corrected)))
    assert candidates.best == int(np.argmax(scores)) == 2
    assert mnc_subpixel(candidates.best_kernel, BENT.psf(63)) > 0.6
    order = np.argsort(scores)
    assert (np.diff(candidates.probabilities[order]) > 0).all()


@pytest.mark.parametrize(
    ("pair", "is_alike", "is_believed"),
    [((LOST[1], LOST[1]), True, False), ((LOST[0], BENT), False, True)],
)
def test_neither_agreement_nor_the_photo_s_belief_is_enough_alone(
    finding, uncorrected, pair, is_alike, is_believed
):
    photo = camera_photo(BENT)
    half = BENT.scaled(0.5)
    searched = [motion.psf(63) for motion in pair]
    assert (mnc_subpixel(*searched) >= 0.85) == is_alike
    score = kernel_score(Judge(photo[None]).evidence(searched)).max()
    assert (score >= 0.4) == is_believed
    finding({256: pair, 128: (half, half)})
    candidates = MotDiffEstimator().search(photo[None], Progress(), lambda: photo[None, ::2, ::2])
    assert len(candidates.kernels) == 3
    assert candidates.best == (1 if is_believed else 2)


def test_the_third_kernel_is_the_better_one_at_half_the_size_and_corrected(monkeypatch, finding):
    """Beside the better one of the two that differ, as corrected."""
    photo = camera_photo(BENT)
    half = BENT.scaled(0.5)
    finding({256: LOST, 128: (LOST[1], half)})
    asked = []
    answers = []

    def noted(_network, crops, kernel, rivals, *, sigma):
        asked.append((crops.shape[-1], kernel, rivals, sigma))
        answers.append(kernel.copy())
        return answers[-1]

    monkeypatch.setattr(module, "corrected_kernel", noted)
    candidates = MotDiffEstimator().search(photo[None], Progress(), lambda: photo[None, ::2, ::2])
    assert [side for side, *_ in asked] == [256, 256, 128, 128, 256]
    likelier = int(np.argmax(kernel_score(Judge(photo[None]).evidence(answers[:2]))))
    _, kernel, (rival,), sigma = asked[-1]
    np.testing.assert_array_equal(kernel, enlarged_kernel(half.psf(63)))
    assert rival is answers[likelier]
    assert sigma == shared_sigma(photo[None])
    assert mnc_subpixel(candidates.kernels[2], kernel) > 0.99  # without its faintest light


def test_kernels_come_in_odd_frames_without_their_faintest_light():
    psfs = np.zeros((2, 64, 64))
    psfs[0, 32, 32], psfs[0, 0, 5] = 0.75, 0.25  # what lies on the first row has no place
    psfs[1, 30, 36], psfs[1, 31, 36], psfs[1, 63, 63] = 0.98, 0.03, 0.01  # the last is faint
    cut, faint = in_odd_frames(list(psfs))
    assert cut.shape == faint.shape == (63, 63)
    assert np.argwhere(cut).tolist() == [[31, 31]]
    assert np.argwhere(faint).tolist() == [[29, 35], [30, 35]]
    assert cut.sum() == pytest.approx(1)
    assert faint.sum() == pytest.approx(1)


def test_agreement_of_two_kernels_makes_all_of_them_likelier(finding, uncorrected):
    photo = camera_photo(BENT)
    near = Trajectory.straight(10.0, angle_rad=2.2)
    found = []
    for pair in (LOST, (LOST[0], near)):
        finding({256: pair})
        found.append(MotDiffEstimator().search(photo[None], Progress()))
    apart, alike = found
    assert alike.details["agreement"] > apart.details["agreement"]
    assert alike.probabilities[0] > apart.probabilities[0]


@pytest.mark.parametrize("log_odds", [module._LOG_ODDS_AGREED, module._LOG_ODDS_DOUBTED])
def test_a_kernel_is_likelier_by_its_score_and_by_agreement(log_odds):
    scores = np.array([0.2, 0.5, 0.8])
    apart, alike = (probability_good(scores, agreement, log_odds) for agreement in (0.8, 1.0))
    assert (np.diff(apart) > 0).all()
    assert (alike > apart).all()
    assert 0 < apart[0] < 0.5 < alike[2] < 1


def test_an_agreeing_pair_that_is_likelier_wrong_than_good_is_searched_at_half_the_size(
    monkeypatch, finding, uncorrected
):
    """At the least agreement and the least score: neither alone asks for the search."""
    near = Trajectory.straight(9.0, angle_rad=2.33)
    assert 0.85 < mnc_subpixel(LOST[0].psf(63), near.psf(63)) < 0.9
    photo = camera_photo(BENT)
    monkeypatch.setattr(module, "kernel_score", lambda evidence: np.full(len(evidence), 0.41))
    searches = finding({256: (LOST[0], near), 128: (BENT.scaled(0.5),) * 2})
    MotDiffEstimator().search(photo[None], Progress(), lambda: photo[None, ::2, ::2])
    assert len(searches.shapes) == 2


@pytest.mark.parametrize("half", [None, (Trajectory.straight(42.0, angle_rad=0.3),) * 2])
def test_two_kernels_are_left_of_a_small_photo_and_where_the_third_outgrows_the_frame(
    finding, uncorrected, half
):
    photo = camera_photo(BENT)
    searches = finding({256: LOST, 128: half})
    halved = None if half is None else (lambda: photo[None, ::2, ::2])
    candidates = MotDiffEstimator().search(photo[None], Progress(), halved)
    assert len(searches.shapes) == (1 if half is None else 2)
    assert len(candidates.kernels) == len(candidates.corrected) == 2
    assert candidates.origins == ("search", "search")


def test_an_enlarged_kernel_is_twice_as_large_and_lies_where_it_lay():
    aside = np.roll(BENT.scaled(0.5).psf(31), (3, -2), axis=(0, 1))
    enlarged = enlarged_kernel(aside)
    assert enlarged.shape == (63, 63)
    assert enlarged.sum() == pytest.approx(1)
    for axis in (0, 1):  # their means, from the zero displacement
        mean = (np.arange(31) - 15) @ aside.sum(axis=1 - axis)
        assert (np.arange(63) - 31) @ enlarged.sum(axis=1 - axis) == pytest.approx(2 * mean)
    assert mnc_subpixel(enlarged, BENT.psf(63)) > 0.7
    assert enlarged_kernel(Trajectory.straight(42.0).psf(63)) is None


def test_the_motion_of_a_photo_is_found_by_real_searches():
    photo = camera_photo(BENT)
    estimate = MotDiffEstimator().estimate(photo)
    assert mnc_subpixel(estimate.psf, BENT.psf(64)) > 0.9
    assert mnc_subpixel(estimate.best.psf(), BENT.psf(64)) > 0.85
    assert estimate.method == "motdiff"
    assert estimate.best.direction == "unknown"
    assert estimate.confidence > 0.8
    assert estimate.psf.sum() == pytest.approx(1)
    assert estimate.details["chosen"].startswith("search")
    assert estimate.details["crops"] == 1


# ---- the correction


def test_the_likeliest_different_kernels_are_corrected_and_the_photo_chooses(monkeypatch, shaken):
    """Kernel 1 was the likeliest, and 3 fits the photo once it is corrected; 2 is like 1."""
    wrong = [Trajectory.straight(12.0, angle_rad=angle).psf(63) for angle in (1.5, 2.0, 2.4)]
    kernels = tuple(wrong[i].copy() for i in (0, 1, 1, 2))
    found = FoundKernels(
        kernels, np.array([0.1, 0.7, 0.6, 0.3]), 1, {"steps": 1}, origins=tuple("abcd")
    )
    told = []

    def noted(_network, crops, kernel, rivals, *, sigma):
        numbers = [
            next(i for i, known in enumerate(kernels) if known is asked)
            for asked in (kernel, *rivals)
        ]
        told.append(tuple(numbers))
        assert np.array_equal(crops, shaken[None])
        assert sigma == pytest.approx(noise_sigma(shaken))
        return STRAIGHT.psf(63) if numbers[0] == 3 else kernel

    monkeypatch.setattr(module, "corrected_kernel", noted)
    better = MotDiffEstimator().corrected(shaken[None], found, Progress())
    assert sorted(told) == [(0, 1, 2), (1, 2, 3), (3, 1, 2)]
    assert better.best == 3
    assert mnc_subpixel(better.kernels[3], STRAIGHT.psf(63)) > 0.99
    assert better.kernels[2] is kernels[2]
    assert better.confidence == 0.7
    assert sorted(better.probabilities[[0, 1, 3]]) == pytest.approx([0.1, 0.3, 0.7])
    assert better.probabilities[2] == 0  # superseded by 1
    assert (better.details, better.origins) == (found.details, found.origins)


def test_a_correction_makes_no_kernel_likelier_than_the_best_was(monkeypatch, uncorrected, shaken):
    kernels = tuple(
        Trajectory.straight(12.0, angle_rad=angle).psf(63) for angle in (1.5, 2.0, 2.4)
    )
    found = FoundKernels(kernels, np.array([0.9, 0.4, 0.2]), 1)
    better = MotDiffEstimator().corrected(shaken[None], found, Progress())
    assert better.confidence == 0.4
    assert sorted(better.probabilities) == pytest.approx([0.2, 0.4, 0.4])


def test_a_correction_keeps_the_sum_and_takes_kernels_of_any_frame(shaken):
    kernels = [STRAIGHT.psf(size) for size in (29, 63, 64)]
    found = corrected_kernel(load_correction(), shaken[None], kernels[0], kernels[1:], sigma=0.005)
    alone = corrected_kernel(
        load_correction(), shaken[None], kernels[0], kernels[1:2], sigma=0.005
    )
    assert found.shape == (63, 63)
    assert found.min() >= 0
    assert found.sum() == pytest.approx(1)
    assert mnc_subpixel(found, STRAIGHT.psf(64)) > 0.95
    np.testing.assert_allclose(alone, found, atol=1e-4)  # the other one stands for both


# ---- photos of any size, repeatability, refusals, progress


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((100, 140), (1, 100, 140)),
        ((64, 64), (1, 64, 64)),
        ((300, 300), (1, 300, 300)),
        ((500, 700), (3, 256, 256)),
    ],
)
def test_photos_of_any_size(finding, uncorrected, shape, expected):
    searches = finding({expected[2]: (STRAIGHT, STRAIGHT)})
    estimate = MotDiffEstimator().estimate(leaves(*shape))
    assert searches.shapes[0] == expected
    assert estimate.psf.sum() == pytest.approx(1)
    assert np.isfinite(estimate.psf).all()
    assert estimate.details["crops"] == expected[0]


def test_at_most_so_many_crops_as_asked_for(finding, uncorrected):
    searches = finding({256: (STRAIGHT, STRAIGHT)})
    MotDiffEstimator(crops=2).estimate(leaves(500, 700))
    assert searches.shapes[0] == (2, 256, 256)


def test_the_same_photo_and_seed_give_the_same_estimate(shaken):
    first, again = (MotDiffEstimator(seed=4).estimate(shaken[:72, :80]) for _ in range(2))
    np.testing.assert_array_equal(first.psf, again.psf)
    np.testing.assert_array_equal(first.best.xy, again.best.xy)
    assert (first.confidence, first.details, first.weights) == (
        again.confidence,
        again.details,
        again.weights,
    )


def test_the_seed_is_that_of_the_paths_drawn(monkeypatch, finding, uncorrected, shaken):
    seeds = []

    class Drawn:
        def orders(self):
            return (PathOrder(STRAIGHT, 1.0, 0.9),)

    def noted(_denoiser, _kernel, *, count, rng):
        seeds.append(rng.integers(2**62))
        return Drawn()

    monkeypatch.setattr(module, "simple_motion", lambda *_, **__: None)
    monkeypatch.setattr("motdiff.estimators.description.plain_trajectory", lambda *_, **__: None)
    monkeypatch.setattr("motdiff.network.path_drawing.draw_paths", noted)
    finding({shaken.shape[1]: (STRAIGHT, STRAIGHT)})
    for seed in (4, 5):
        MotDiffEstimator(seed=seed).estimate(shaken)
    MotDiffEstimator().estimate(shaken)
    assert seeds == [np.random.default_rng(seed).integers(2**62) for seed in (4, 5, 0)]


def test_each_crop_alone_is_searched_once(monkeypatch):
    asked = []
    real = module.quick_kernels

    def noted(photos, *, sigma, starts, fine_weights):
        asked.append((tuple(photos.shape), sigma, starts, fine_weights))
        return real(photos, sigma=sigma, starts=starts, fine_weights=fine_weights)

    monkeypatch.setattr(module, "quick_kernels", noted)
    crops = np.stack([photo_of(STRAIGHT, 80, 80, seed=seed) for seed in range(3)])
    found = FoundKernels((STRAIGHT.psf(63),), np.ones(1), 0)
    singles = MotDiffEstimator().single(crops, found, Progress())
    assert len(singles) == 3
    assert sorted(call[1] for call in asked) == sorted(noise_sigma(crop) for crop in crops)
    assert {(call[0], *call[2:]) for call in asked} == {((1, 1, 80, 80), QUICK_STARTS[:1], ())}
    assert all(single.sum() == pytest.approx(1) for single in singles)


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (
            np.full((100, 100), 0.4),
            "photo: is constant; motion shows only where the scene has texture",
        ),
        (
            np.random.default_rng(0).random((63, 200)),
            "photo: needs at least 64 x 64 px, got 200 x 63",
        ),
        (np.full((100, 100), np.nan), "photo: must be finite, found NaN or infinity"),
        (np.zeros(5), "photo: must be (H, W) or (H, W, C), got shape (5,)"),
    ],
)
def test_unusable_photos_are_refused_in_one_line(photo, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the whole message is compared
        MotDiffEstimator().estimate(photo)
    assert str(caught.value) == message


def test_the_number_of_crops_must_be_positive():
    with pytest.raises(ValueError, match=r"^crops: must be at least 1, got 0$"):
        MotDiffEstimator(crops=0)


@pytest.mark.parametrize("pair", [(STRAIGHT, STRAIGHT), LOST])
def test_progress_rises_to_one(finding, uncorrected, pair):
    photo = photo_of(STRAIGHT, 192, 192)
    finding({192: pair, 96: pair})
    seen = []
    estimator = MotDiffEstimator(progress=seen.append)
    for _ in range(2):  # of each photo from the start
        seen.clear()
        estimator.estimate(photo)
        assert seen == sorted(seen)
        assert seen[-1] == 1
        assert len(set(seen)) == len(seen)
        assert np.diff([0, *seen]).max() < 0.7


class Plan(Progress):
    """Notes what is left of it."""

    left = 0.0

    def expect(self, cost):
        self.left = cost

    def expect_more(self, cost):
        self.left += cost

    def spend(self, cost):
        self.left -= cost


def test_searches_spend_what_they_plan_at_full_and_at_half_size(finding, uncorrected):
    photo = camera_photo(BENT)
    left = []
    for pair in ((BENT, BENT), LOST):
        finding({256: pair})
        plan = Plan()
        MotDiffEstimator().search(photo[None], plan, lambda: photo[None, ::2, ::2])
        left.append(plan.left)
    assert left[0] == pytest.approx(left[1])  # what follows is the same
    assert left[0] > 0


def test_a_cached_estimate_depends_on_both_networks():
    assert MotDiff().weight_files() == (CORRECTION_WEIGHTS, PATH_WEIGHTS)
    assert all(file.is_file() for file in MotDiff().weight_files())
