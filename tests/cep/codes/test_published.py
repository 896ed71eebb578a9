"""The registry, re-measured on the continuous circle: table of published codes, false claims
included."""

from pathlib import Path

import numpy as np
import pytest

from cep.codes.published import CLAIMS, PUBLISHED, for_chips, names, published
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum, min_chip
from lab.bench.published_codes import chip_noise_db

# name, chips, open, min |P|, absolute noise gain in dB (None: a true zero makes it infinite)
TABLE = [
    ("raskar-52", 52, 26, 1.3237, -9.40),
    ("merl-32-t64", 32, 16, 0.3756, -6.92),
    ("bdinr-8", 8, 5, 0.9128, -3.29),
    ("merl-31-t62", 31, 21, 0.0000, None),
    ("merl-31-t93", 31, 21, 1.5797, -7.84),
    ("merl-32-t96", 32, 16, 0.1970, -6.69),
    ("merl-50-t850", 50, 25, 1.3688, -9.22),
    ("merl-64-t128", 64, 32, 0.4015, -8.37),
    ("merl-64-t192", 64, 32, 0.7541, -9.60),
    ("jeon-30", 30, 13, 1.0982, -8.23),
    ("jeon-40", 40, 17, 1.2940, -8.80),
    ("jeon-50", 50, 22, 1.4716, -10.28),
    ("jeon-60", 60, 26, 1.4989, -10.74),
    ("jeon-70", 70, 30, 1.5684, -11.85),
    ("jeon-80", 80, 35, 1.4193, -11.50),
    ("jeon-90", 90, 46, 1.1760, -11.88),
    ("jeon-100", 100, 52, 1.5269, -13.14),
    ("jeon-110", 110, 55, 1.7004, -13.10),
    ("jeon-120", 120, 62, 2.0446, -13.95),
    ("jeon-130", 130, 67, 2.5090, -14.24),
    ("jeon-140", 140, 67, 1.5462, -14.30),
    ("jeon-150", 150, 71, 2.1106, -14.59),
    ("jeon-160", 160, 75, 1.2839, -14.21),
    ("jeon-170", 170, 86, 2.3248, -15.15),
    ("jeon-180", 180, 86, 1.1587, -14.78),
    ("jeon-190", 190, 87, 1.3693, -14.85),
    ("jeon-200", 200, 93, 1.3502, -15.19),
    ("m-sequence-15", 15, 8, 0.9782, -5.46),
    ("m-sequence-31", 31, 16, 1.2859, -8.44),
    ("m-sequence-63", 63, 32, 0.8384, -9.66),
    ("m-sequence-127", 127, 64, 0.6659, -12.17),
    ("legendre-31", 31, 16, 0.9953, -8.22),
    ("legendre-43", 43, 22, 1.0646, -9.42),
    ("legendre-53", 53, 27, 1.0000, -10.29),
    ("legendre-61", 61, 31, 0.8118, -10.30),
    ("barker-13", 13, 9, 1.3624, -5.81),
]


def test_table_is_complete():
    assert {row[0] for row in TABLE} == set(names()) == set(PUBLISHED)
    assert all(published(name).works for name in names())


@pytest.mark.parametrize(("name", "chips", "opened", "minimum", "noise_db"), TABLE)
def test_table_is_reproduced(name, chips, opened, minimum, noise_db):
    code = PUBLISHED[name]
    assert (code.chips, code.open_chips) == (chips, opened)
    assert min_chip(code) == pytest.approx(minimum, abs=6e-5)
    if noise_db is not None:
        assert chip_noise_db(code) == pytest.approx(noise_db, abs=0.011)


def test_false_claims_by_merl():
    """0.088 and 0.119 of DC were claimed, on grids of 62 and 64 points; the truth is 0 and
    0.0235."""
    for name, (points, claimed) in CLAIMS.items():
        code = PUBLISHED[name]
        assert np.abs(np.fft.fft(code.array, points)).min() / code.open_chips == pytest.approx(
            claimed, abs=1e-3
        )
    for name, truth, told in (("merl-31-t62", 0.0, "0.0000"), ("merl-32-t64", 0.0235, "0.0235")):
        found = chip_minimum(PUBLISHED[name])
        assert found.upper / PUBLISHED[name].open_chips == pytest.approx(truth, abs=5e-5)
        assert f"{found.lower / PUBLISHED[name].open_chips:.4f}" == told
    assert chip_minimum(PUBLISHED["merl-31-t62"]).at == (1 / 6,)
    assert chip_minimum(PUBLISHED["merl-31-t62"]).upper == 0


LEAGUE = [
    [cell.strip() for cell in line.strip("|\n").split("|")]
    for line in (Path(__file__).resolve().parents[3] / "docs" / "league.md")
    .read_text()
    .replace("\\|", "")
    .splitlines()
    if line.startswith("| ") and not line.startswith(("| code", "| ---"))
]


def test_the_league_is_complete():
    assert [row[0] for row in LEAGUE] == [*names(), *CLAIMS]


@pytest.mark.parametrize("row", LEAGUE[: len(names())], ids=lambda row: row[0])
def test_the_league_is_what_is_measured_now(row):
    name, chips, opened, interval, relative, claim, noise, noise_dc = row
    code = PUBLISHED[name]
    found = chip_minimum(code)
    assert (int(chips), int(opened)) == (code.chips, code.open_chips)
    assert interval == f"{found.lower:.4f} .. {found.upper:.4f}"
    assert float(relative) == pytest.approx(found.upper / code.open_chips, abs=6e-5)
    assert float(claim) == pytest.approx(np.abs(np.fft.fft(code.array)).min(), abs=6e-5)
    measured = chip_noise_db(code) if found.upper > 0 else np.inf
    assert float(noise) == pytest.approx(measured, abs=6e-3)
    assert float(noise_dc) == pytest.approx(measured + 20 * np.log10(code.open_chips), abs=6e-3)


@pytest.mark.parametrize("row", LEAGUE[len(names()) :], ids=lambda row: row[0])
def test_the_claims_are_what_is_measured_now(row):
    name, points, claim, relative, at, proof = row
    found = chip_minimum(PUBLISHED[name])
    assert (int(points), float(claim)) == CLAIMS[name]
    assert float(relative) == pytest.approx(found.upper / PUBLISHED[name].open_chips, abs=6e-5)
    assert float(at) == pytest.approx(found.at[0], abs=2e-6)
    assert proof == found.method


def is_best_rotation(code):
    rotations = [ShutterCode(code.bits[i:] + code.bits[:i]) for i in range(code.chips)]
    return min_chip(code) >= max(map(min_chip, rotations)) * (1 - 1e-9)


@pytest.mark.parametrize("chips", [15, 31, 63, 127])
def test_m_sequences_have_a_two_valued_autocorrelation_and_are_rotated_best(chips):
    code = PUBLISHED[f"m-sequence-{chips}"]
    signs = 2 * code.array - 1
    assert np.allclose(np.fft.ifft(np.abs(np.fft.fft(signs)) ** 2).real[1:], -1)
    assert is_best_rotation(code)


@pytest.mark.parametrize("prime", [31, 43, 53, 61])
def test_legendre_sequences_are_the_squares_rotated_best(prime):
    """Their spectrum is flat on its own grid only."""
    squares = {i * i % prime for i in range(prime)}
    sequence = "".join(str(int(i in squares)) for i in range(prime))
    code = PUBLISHED[f"legendre-{prime}"]
    assert code.bits in 2 * sequence
    on_grid = np.abs(np.fft.fft(code.array))[1:]
    assert np.ptp(on_grid) < 1.1
    assert min_chip(ShutterCode(sequence)) < 0.5 * on_grid.min()
    assert is_best_rotation(code)


def test_lookup():
    assert {entry.name for entry in for_chips(31)} == {
        "merl-31-t62",
        "merl-31-t93",
        "m-sequence-31",
        "legendre-31",
    }
    assert for_chips(33) == ()
    assert published("bdinr-8").code == ShutterCode("11100101")


def test_an_unknown_name_is_told_the_others():
    with pytest.raises(ValueError, match="no published code 'raskar'; there are bdinr-8"):
        published("raskar")
