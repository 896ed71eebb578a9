"""The verdict: never a code while something simpler is better, and the published limit of what a
code can gain."""

import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cep
from cep.optics.band import band_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.search.advise import advise
from cep.search.code_search import SearchOptions
from cep.search.expected import WORTH_DB, ExpectedPsnr, light_noise
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from cep.search.verdict import verdict
from hw.device import DeviceProfile
from lab.frames.optimum import frames_verdict, optimize_frames
from lab.fronts.comparison import pareto
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

NOISY = Camera(photons_full_scale=10_000, read_noise_e=50)
QUIET = Camera(photons_full_scale=10_000, read_noise_e=2)
STRAIGHT = Trajectory.straight(24.0)


def expected_psnr_db(problem, codes, *, noise, path_error_px=0.0):
    return ExpectedPsnr(problem, path_error_px=path_error_px).psnr_db(codes, noise=noise)


def along(path=STRAIGHT, chips=24, **options):
    return SearchProblem.along(path, chips=chips, **options)


# -- what is advised ------------------------------------------------------------------------------


def random_problem(seed):
    """Draw a motion, a camera and limits, with random codes within them."""
    rng = np.random.default_rng(seed)
    chips = int(rng.integers(5, 10))
    path = (
        Trajectory.straight(rng.uniform(4, 30))
        if rng.random() < 0.5
        else boracchi_foi(rng, max_length_px=30, samples=60)
    )
    low = int(rng.integers(1, 4))
    camera = Camera(
        photons_full_scale=10 ** rng.uniform(2, 5), read_noise_e=10 ** rng.uniform(0, 2.3)
    )
    problem = along(
        path,
        chips,
        camera=camera,
        objective="mse",
        open_range=(low, int(rng.integers(low, chips + 1))),
        runs=RunLimits(min_open=int(rng.integers(1, low + 1))),
    )
    return problem, [ShutterCode(code) for code in problem.random_codes(4, rng=rng)]


def best_single_db(problem, frames=1):
    """Brute force over all single exposures within the limits, in so many frames; -inf where there
    is none."""
    n = problem.chips
    runs = [
        ShutterCode("0" * first + "1" * (end - first) + "0" * (n - end))
        for first in range(n)
        for end in range(first + 1, n + 1)
    ]
    kept = [run for run in runs if problem.allows(run)]
    if not kept:
        return -np.inf
    return expected_psnr_db(
        problem, kept, noise=[light_noise(problem.camera, kept) / frames]
    ).max()


def check_that_no_single_exposure_is_better(problem, found, frames=1):
    advised = found.advised
    assert advised.within_limits
    if advised.kind in ("code", "strobe"):
        assert advised.psnr_db >= best_single_db(problem, frames) - 1e-6
        assert found.sentence.startswith(("Code", "Pulse"))
    if advised.kind == "snapshot":
        assert (
            max(found.gains_db[kind] for kind in found.gains_db)
            < found.gains_db["snapshot"] + WORTH_DB
        )
        assert found.sentence.startswith("Coding does not pay here: expose")


@pytest.mark.slow(reason="two hundred random problems")
@settings(max_examples=200, deadline=None)  # as many as were asked for
@given(seed=st.integers(0, 10**6))
def test_no_code_is_advised_while_a_single_exposure_within_the_limits_is_better(seed):
    """On random motions, cameras, limits and codes, for one frame and for two; every output's
    advice is made so."""
    problem, codes = random_problem(seed)
    found = verdict(problem, *codes)
    check_that_no_single_exposure_is_better(problem, found)
    assert problem.allows(found.advised.code)
    if seed % 4 == 0:
        check_that_no_single_exposure_is_better(
            problem, frames_verdict(problem, codes[:2]), frames=2
        )


@pytest.mark.slow(reason="four searches of each problem")
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_nor_by_what_a_search_reports(seed):
    """The searches themselves: of one code by any objective, of a front, of frames, and over the
    light."""
    problem, _ = random_problem(seed)
    objective = ("mse", "noise", "flatness")[seed % 3]
    with suppress(
        ValueError
    ):  # a path too short for its chips, or a front whose codes all have a zero
        found = [
            cep.optimize(replace(problem, objective=objective), steps=50, seed=seed).verdict,
            advise(problem, levels=[]).here,
            pareto(problem, steps=50).verdict,
        ]
        for one in found:
            check_that_no_single_exposure_is_better(problem, one)
        pair = optimize_frames(
            replace(problem, objective=objective), SearchOptions(steps=50), 2
        ).verdict
        check_that_no_single_exposure_is_better(problem, pair, frames=2)


def test_the_kinds_of_a_verdict():
    codes = [
        ShutterCode(bits)
        for bits in ("110110110110", "110110110100", "111000000111", "110110010110")
    ]
    kinds = [way.kind for way in verdict(along(chips=12, camera=NOISY), *codes).exposures]
    assert kinds[0] == "open"
    assert [
        way.kind
        for code in codes
        for way in verdict(along(chips=12), code).exposures
        if way.code == code
    ] == [
        "strobe",
        "code",
        "code",
        "code",
    ]


def test_the_sentence_names_what_was_judged():
    """A search that ends on a single opening found no better code; a code of the user's is
    compared with."""
    single, coded = (
        verdict(along(camera=QUIET), ShutterCode(bits))
        for bits in ("1" + "0" * 23, "110100101011" * 2)
    )
    assert single.choice == coded.choice == "snapshot"
    assert "; no code that was tried is better. " in single.sentence
    assert " dB over " not in single.sentence.partition("over the open shutter")[2]
    gain = coded.advised.psnr_db - next(
        way.psnr_db for way in coded.exposures if way.code.bits == "110100101011" * 2
    )
    assert f" and about {gain:.1f} dB over this code. " in coded.sentence


def test_the_sentence_says_under_which_conditions():
    found = verdict(along(camera=NOISY))
    assert found.sentence.endswith(
        "at 10,000 photo-electrons at full scale and 50 e- of read noise."
    )
    warm = along(Trajectory.straight(8.0), 6, camera=replace(NOISY, dark_current_e_s=20.0))
    known = verdict(warm, path_error_px=0.25)
    assert known.sentence.endswith(
        "50 e- of read noise, 20 e-/s of dark current and a path known to 0.25 px."
    )


def test_a_short_share_is_said_in_digits():
    camera = Camera(photons_full_scale=1e6, read_noise_e=1)
    found = verdict(along(Trajectory.straight(400.0), 104, camera=camera))
    assert found.advised.code.open_chips == 1
    assert "expose 1/100 of the time" in found.sentence


def test_fixed_noise_makes_coding_pay_and_photon_noise_does_not():
    noisy, quiet = (
        advise(along(camera=camera), levels=[1_000, 100_000]) for camera in (NOISY, QUIET)
    )
    assert noisy.choice == "code"
    assert noisy.gains_db["code"] > noisy.gains_db["snapshot"] + 1
    assert noisy.sentence.startswith("Code this exposure: ")
    assert quiet.choice == "snapshot"
    assert quiet.gains_db["snapshot"] > quiet.gains_db["code"]
    assert quiet.sentence.startswith("Coding does not pay here: expose 1/")


def test_the_crossover_is_where_the_gain_crosses_what_counts():
    advice = advise(
        along(camera=replace(NOISY, read_noise_e=10.0)), levels=[100, 1_000, 10_000, 100_000]
    )
    gains = {one.camera.photons_full_scale: one.code_gain_db for one in advice.levels}
    for level, gain in gains.items():
        inside = any((low or 0) <= level <= (high or np.inf) for low, high in advice.crossover)
        assert inside == (gain > WORTH_DB)
    between = [end for ends in advice.crossover for end in ends if end is not None]
    assert between  # this camera's gain falls below what counts in bright light
    at_end = advise(along(camera=replace(NOISY, read_noise_e=10.0)), levels=between)
    for end in between:
        one = next(one for one in at_end.levels if one.camera.photons_full_scale == end)
        # interpolated over a decade of light, between gains that lie dBs apart
        assert one.code_gain_db == pytest.approx(WORTH_DB, abs=0.6)


def test_nothing_is_called_better_by_less_than_nothing():
    """Limits that cost light: what they leave is worse than the open shutter, which is named."""
    found = verdict(along(Trajectory.straight(10.0), 20, camera=Camera(100.0), open_range=(2, 4)))
    assert found.gains_db["snapshot"] < 0
    assert re.search(r"loses about [\d.]+ dB to the open shutter", found.sentence)
    assert found.outside.kind in ("open", "snapshot")
    assert "If the limits can be loosened, " in found.sentence


def test_limits_that_leave_only_codes():
    only = along(camera=NOISY, open_range=(8, 12), runs=RunLimits(max_open=3))
    advice = advise(only, levels=[1_000, 30_000])
    assert advice.choice in ("code", "strobe")
    assert advice.where == "Only codes keep these limits, at any light."
    assert advice.crossover == ((None, None),)


@pytest.mark.slow  # fifty paths
def test_a_path_known_less_exactly_is_judged_on_every_single_exposure():
    """The best snapshot of an exact path need not be the best of one that is known to 1 px."""
    path = boracchi_foi(np.random.default_rng(2), max_length_px=40, samples=60)
    problem = along(path, 13, camera=Camera(photons_full_scale=3_000, read_noise_e=10))
    runs = [
        ShutterCode("0" * first + "1" * (end - first) + "0" * (13 - end))
        for first in range(13)
        for end in range(first + 1, 14)
    ]
    best = expected_psnr_db(
        problem, runs, noise=[light_noise(problem.camera, runs)], path_error_px=2.0
    ).max()
    found = verdict(problem, path_error_px=2.0)
    assert found.advised.psnr_db >= best - WORTH_DB
    assert max(
        way.psnr_db for way in found.exposures if way.kind in ("open", "snapshot")
    ) == pytest.approx(best)


def test_at_equal_light_the_best_exposure_is_another():
    found = advise(along(camera=NOISY), levels=[]).here
    shortest = found.best("snapshot", by="equal_light_db")
    assert shortest.code.open_chips < found.best("snapshot").code.open_chips
    assert (
        found.equal_light_gains_db["snapshot"]
        == shortest.equal_light_db - found.exposures[0].equal_light_db
    )


def test_a_camera_with_more_electrons_than_others_is_advised_on():
    hot = replace(Camera.load("microbolometer"), least_exposure_s=0.0)
    assert advise(along(chips=8, camera=hot), levels=[]).choice in (
        "open",
        "snapshot",
        "strobe",
        "code",
    )


def test_limits_of_the_shutter_rule_what_is_advised():
    """A shutter that must stay open for a third of the exposure cannot take the better snapshot:
    it is named."""
    slow = DeviceProfile(name="slow", min_on_ns=8_000_000)
    found = verdict(along(camera=QUIET, device=slow))
    assert found.advised.code.open_chips >= 8
    assert found.outside is not None
    assert found.outside.kind == "snapshot"
    assert "If the limits can be loosened, a single exposure" in found.sentence


@pytest.mark.slow  # fifty paths
def test_an_error_of_the_path_turns_the_verdict():
    problem = along(camera=NOISY)
    assert advise(problem, levels=[]).choice == "code"
    lost = advise(problem, levels=[], path_error_px=3.0)
    assert lost.choice == "snapshot"
    assert lost.here.best("code").psnr_db < lost.here.best("snapshot").psnr_db


def test_a_flash_favours_the_short_exposure():
    """At equal light nothing is lost by a shorter exposure but what the code would keep."""
    found = advise(along(camera=NOISY), levels=[]).here
    assert found.equal_light_gains_db["snapshot"] > found.gains_db["snapshot"]


SMALL = Camera(photons_full_scale=1_000, read_noise_e=20, full_well_e=5_000.0)


def test_ways_that_saturate_are_no_ways():
    """At 20,000 of 5,000 electrons a quarter of the exposure can be recorded: 2 of 8 chips, of
    whatever way."""
    advice = advise(
        along(chips=8, camera=replace(SMALL, photons_full_scale=20_000.0)), levels=[1_000]
    )
    here = advice.here
    assert {way.code.open_chips for way in here.possible} == {1, 2}
    assert all(way.saturates == (way.code.open_chips > 2) for way in here.exposures)
    assert advice.choice == "snapshot"
    assert here.open_saturates
    assert "open" not in here.gains_db
    assert here.equal_light_gains_db == {}
    assert "the open shutter" not in here.sentence.removesuffix(
        "The open shutter saturates at this light."
    )
    assert here.sentence.endswith("The open shutter saturates at this light.")
    assert not advice.levels[0].open_saturates


def test_a_code_within_what_can_be_recorded_is_searched():
    """Read noise makes coding pay; the code found is the best of those that are dark enough, by
    brute force."""
    bright = Camera(photons_full_scale=40_000, read_noise_e=200, full_well_e=10_100.0)
    here = advise(along(STRAIGHT, 12, camera=bright), levels=[]).here
    assert here.best("code").code.open_chips <= 3
    dark = [ShutterCode(f"{bits:012b}") for bits in range(1, 2**12) if bits.bit_count() <= 3]
    best = expected_psnr_db(
        along(STRAIGHT, 12, camera=bright), dark, noise=[light_noise(bright, dark)]
    ).max()
    assert here.advised.psnr_db >= best - WORTH_DB


def test_dark_current_fills_the_well_of_a_code_and_not_of_a_snapshot():
    warm = replace(SMALL, photons_full_scale=8_000.0, dark_current_e_s=4_000 / 0.024)
    bits = ("1000001" + "0" * 17, "101010" * 4, "1" * 8 + "0" * 16, "1" * 12 + "0" * 12)
    found = verdict(along(camera=warm, exposure_s=0.024), *map(ShutterCode, bits)).exposures
    ways = {way.code.bits: way for way in found}
    # 667 + 4,000, 4,000 + 4,000, 2,667 + 1,333 and 4,000 + 2,000 electrons
    assert [ways[code].saturates for code in bits] == [False, True, False, True]


def test_levels_at_which_the_shortest_opening_saturates_are_left_out():
    advice = advise(along(chips=8, camera=SMALL))
    assert max(one.camera.photons_full_scale for one in advice.levels) == 30_000  # of 40,000
    with pytest.raises(
        ValueError,
        match=r"photons_full_scale: this camera is full at 5,000 electrons, and at a light",
    ):
        advise(along(chips=8, camera=replace(SMALL, photons_full_scale=41_000.0)))
    with pytest.raises(
        ValueError, match=r"the shortest opening, 0.25 of the exposure, collects 5,250"
    ):
        verdict(
            along(chips=8, camera=replace(SMALL, photons_full_scale=21_000.0), open_range=(2, 8))
        )


def test_a_code_that_saturates_is_not_advised_and_warned_of():
    """Limits that ask for half of the light: the code that is found cannot be recorded, a shorter
    exposure can."""
    bright = Camera(photons_full_scale=12_000, read_noise_e=200, full_well_e=5_000.0)
    best = cep.optimize(
        along(chips=12, camera=bright, open_range=(4, 8), objective="mse"), steps=20_000
    )
    assert best.code.open_chips > 5
    assert best.verdict.advised.code.open_chips <= 5
    assert any("saturates at this light" in line for line in best.warnings)


def test_dark_current_counts():
    warm = Camera(photons_full_scale=10_000, read_noise_e=2, dark_current_e_s=1e5)
    cold = replace(warm, dark_current_e_s=0.0)
    shortest = "1" + "0" * 23
    code = "110100101011" * 2
    found, without = (
        {
            way.code.bits: way
            for way in verdict(along(camera=camera, exposure_s=0.024), ShutterCode(code)).exposures
        }
        for camera in (warm, replace(cold, read_noise_e=float(np.sqrt(4 + 2400))))
    )
    assert found[code].psnr_db == pytest.approx(
        without[code].psnr_db
    )  # 2,400 dark electrons in 24 ms
    assert found["1" * 24].psnr_db == pytest.approx(without["1" * 24].psnr_db)
    own = verdict(
        along(camera=replace(cold, read_noise_e=float(np.sqrt(4 + 100))), exposure_s=0.024)
    )
    assert found[shortest].psnr_db == pytest.approx(
        next(w.psnr_db for w in own.exposures if w.code.bits == shortest)
    )


def test_dark_current_is_of_no_account_to_a_snapshot_and_turns_the_verdict():
    """Fixed noise makes coding pay; the same noise from dark current does not reach a short
    exposure."""
    noisy = NOISY
    dark = replace(NOISY, read_noise_e=2.0, dark_current_e_s=2500 / 0.024)
    fixed, warm = (
        advise(along(camera=camera, exposure_s=0.024), levels=[]) for camera in (noisy, dark)
    )
    assert fixed.choice == "code"
    assert warm.gains_db["code"] == pytest.approx(fixed.gains_db["code"], abs=0.1)
    assert warm.gains_db["snapshot"] > fixed.gains_db["snapshot"] + 1


@pytest.mark.parametrize("level", [0.5, 2e7, float("nan")])
def test_light_levels_out_of_range_are_refused(level):
    with pytest.raises(ValueError, match=r"levels: must lie within 1\.\.1e7"):
        advise(along(), levels=[level])


def test_optimize_says_first_whether_to_code():
    best = cep.optimize(along(chips=12, camera=QUIET, objective="noise"), steps=20_000)
    assert best.verdict.choice == "snapshot"
    assert repr(best).startswith(best.verdict.sentence)
    document = best.to_dict()
    assert next(iter(document)) == "verdict"
    assert document["choice"] == "snapshot"


# -- the published limit --------------------------------------------------------------------------

LIMIT = 1.1717
"""Of the gain in RMSE of any flutter over the best snapshot, photon noise alone, full inversion,
no limit in time.

References
----------
Tendero, Morel, Rouge, "The flutter shutter paradox", SIAM Journal on Imaging Sciences 2013.
"""


def noise_of_inversion(code, path):
    """Mean square error of the inverse filter under photon noise, in units of one chip's light."""
    samples = band_samples(path)
    return (
        code.duty
        * samples.weight
        @ (1 / np.abs(coded_otf(path, code, samples.fx, samples.fy)) ** 2)
    )


def test_the_published_limit_is_reproduced():
    """No code passes the band's bound; the best snapshot, blurred over 1.09 px, is 1.1717 times as
    noisy in RMSE."""
    chips = 100
    length_px = 12.0
    path = Trajectory.straight(length_px)
    runs = [
        noise_of_inversion(ShutterCode("1" * k + "0" * (chips - k)), path) for k in range(4, 16)
    ]
    # Cauchy-Schwarz and Parseval: the band is one wide, the light spread over the whole path
    bound = length_px
    assert np.sqrt(min(runs) / bound) == pytest.approx(LIMIT, abs=2e-3)
    rng = np.random.default_rng(3)
    drawn = [ShutterCode(code) for code in along(path, chips).random_codes(200, rng=rng)]
    assert min(noise_of_inversion(code, path) for code in drawn) >= bound
