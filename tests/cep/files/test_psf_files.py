"""PSF files: what is written is read back, what is wrong is named."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import loadmat, savemat
from scipy.signal import convolve2d

from cep.files.images import read_image, write_image
from cep.files.psf_files import load_psf, write_psf
from lab.evaluation.sets import levin_photo
from motdiff.files.trajectories import read_motion
from motdiff.trajectory import Trajectory


@given(
    arrays(np.float64, (5, 5), elements=st.floats(0, 1, width=32)).filter(
        lambda psf: psf.sum() > 0.01
    )
)
def test_a_psf_survives_its_files(tmp_path_factory, psf):
    folder = tmp_path_factory.mktemp("psf")
    npy, mat, png = write_psf(folder, psf)
    single = psf.astype(np.float32)
    assert np.load(npy).dtype == np.float32
    np.testing.assert_array_equal(load_psf(npy)[0], single)
    np.testing.assert_array_equal(loadmat(mat)["psf"], single.astype(np.float64))
    # people's version: eight bits, largest value white, orientation kept
    shown = load_psf(png)[0]
    np.testing.assert_allclose(shown / shown.max(), psf / psf.max(), rtol=0, atol=0.501 / 255)


def test_a_psf_survives_mat(tmp_path):
    psf = np.random.default_rng(0).random((5, 4))
    _, mat, _ = write_psf(tmp_path, psf)
    np.testing.assert_array_equal(load_psf(mat)[0], psf.astype(np.float32))


def test_the_kernel_of_levins_files_is_turned(tmp_path):
    """There y is x convolved with f turned by 180 degrees; with what is read it is x convolved
    with the PSF."""
    rng = np.random.default_rng(0)
    sharp = rng.random((40, 40))
    kernel = rng.random((5, 5))
    blurred = convolve2d(sharp, kernel[::-1, ::-1] / kernel.sum(), mode="valid")
    savemat(tmp_path / "im01_ker01.mat", {"x": sharp[2:-2, 2:-2], "y": blurred, "f": kernel})
    psf = load_psf(tmp_path / "im01_ker01.mat")[0]
    np.testing.assert_allclose(convolve2d(sharp, psf / psf.sum(), mode="valid"), blurred)
    np.testing.assert_allclose(psf / psf.sum(), levin_photo(tmp_path / "im01_ker01.mat").psf)
    savemat(tmp_path / "both.mat", {"f": kernel, "psf": kernel})
    np.testing.assert_array_equal(load_psf(tmp_path / "both.mat")[0], kernel)


@pytest.mark.parametrize(
    "header",
    [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (4, 4), ",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (4, 4) \"\"\"",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 99999999), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (9223372036854775808, 4), }",
        b"{'descr': 7, 'fortran_order': False, 'shape': (4, 4), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (4L, 4L), }",
        b"[" * 60,
    ],
)
def test_a_damaged_header_of_numpys_format(tmp_path, header):
    path = tmp_path / "psf.npy"
    padded = header.ljust(117) + b"\n"
    path.write_bytes(
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded + bytes(8 * 15)
    )
    with pytest.raises(ValueError, match=r"psf\.npy: not a NumPy array file") as caught:
        load_psf(path)[0]
    assert "\n" not in str(caught.value)


def test_a_renamed_zip_is_no_numpy_array(tmp_path):
    np.savez(tmp_path / "a.npz", psf=np.eye(3))
    for content in ((tmp_path / "a.npz").read_bytes(), b"PK\3\4"):
        (tmp_path / "psf.npy").write_bytes(content)
        with pytest.raises(ValueError, match=r"psf\.npy: not a NumPy array file"):
            load_psf(tmp_path / "psf.npy")[0]


def test_a_psf_from_somebody_elses_picture(tmp_path):
    kernel = np.outer([0.0, 1.0, 0.5], [1.0, 0.25, 0.0])
    write_image(tmp_path / "k.png", np.dstack([kernel] * 3), bits=16, gamma="linear")
    np.testing.assert_allclose(load_psf(tmp_path / "k.png")[0], kernel / kernel.sum(), atol=1e-5)


@pytest.mark.parametrize(
    ("psf", "message"),
    [
        (np.zeros((3, 3)), "not all zero"),
        (np.full((3, 3), np.nan), "finite"),
        (-np.eye(3), "not negative"),
        (np.ones((3, 3, 3)), "one table"),
        (np.ones((3, 3), complex), "one table"),
        (np.array([["a"]]), "one table"),
    ],
)
@pytest.mark.parametrize("suffix", [".npy", ".mat"])
def test_an_impossible_psf_is_refused(tmp_path, psf, message, suffix):
    path = tmp_path / f"psf{suffix}"
    if suffix == ".npy":
        np.save(path, psf)
    else:
        savemat(path, {"psf": psf})
    with pytest.raises(ValueError, match=message):
        load_psf(path)[0]


def shifted_line(x, y, *, side=33, duty=1.0):
    psf = Trajectory.straight(12).psf(side)
    return duty * np.roll(psf, (y, x), axis=(0, 1))


@pytest.mark.parametrize(
    ("psf", "said"),
    [
        (shifted_line(0, 0), []),
        (np.ones((1, 15)), []),
        (np.ones((9, 9)), []),
        (np.ones((8, 8)), []),  # its middle is half a pixel off
        (shifted_line(2, 0, duty=0.5), []),  # as the open parts of a code may be
        (shifted_line(5, -3), ["its centre of mass is (+5.0, -3.0) px (x, y) off"]),
        (shifted_line(6, 0, duty=0.5), ["its centre of mass is (+6.0, +0.0) px"]),
        (shifted_line(0, 0) + 5e-4, ["its rim is not 0 but 0.0005"]),
        (shifted_line(4, 0) + 5e-4, ["off its middle", "its rim is not 0"]),
    ],
)
def test_a_psf_off_its_middle_or_with_a_veil_is_told(tmp_path, psf, said):
    np.save(tmp_path / "psf.npy", psf)
    kernel, warnings = load_psf(tmp_path / "psf.npy")
    np.testing.assert_array_equal(kernel, psf)
    assert len(warnings) == len(said)
    for text, warning in zip(said, warnings, strict=True):
        assert warning.startswith(f"{tmp_path / 'psf.npy'}: ")
        assert text in warning


def test_a_restored_photo_moves_as_the_warning_of_its_psf_says(cep, workplace):
    psf = read_motion("trajectory.json").trajectory.psf(33)
    photos = {}
    for name, x, y in (("centred", 0, 0), ("off", 4, -2)):
        np.save(f"{name}.npy", np.roll(psf, (y, x), axis=(0, 1)))
        found = cep.succeeds("deblur", "blurred.png", "--psf", f"{name}.npy", "-o", f"{name}.png")
        assert [("(-4.0, +2.0) px" in warning) for warning in found["warnings"]] == [True] * (
            name == "off"
        )
        photos[name] = read_image(f"{name}.png")
    inner = (slice(40, -40), slice(40, -40))
    moved = np.roll(photos["centred"], (2, -4), axis=(0, 1))
    assert np.corrcoef(moved[inner].ravel(), photos["off"][inner].ravel())[0, 1] > 0.98


def test_broken_psf_files(tmp_path):
    for name in ("a.npy", "a.mat", "a.png"):
        with pytest.raises(FileNotFoundError):
            load_psf(tmp_path / name)[0]
        for content in (b"", b"hello"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(ValueError, match=name):
                load_psf(tmp_path / name)[0]
    np.save(tmp_path / "pickle.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="not a NumPy array file"):
        load_psf(tmp_path / "pickle.npy")[0]
    savemat(tmp_path / "other.mat", {"kernel": np.eye(3)})
    with pytest.raises(ValueError, match=r'wanted a variable "psf" or "f", found kernel'):
        load_psf(tmp_path / "other.mat")[0]


def test_a_psf_that_the_disk_does_not_take_whole_says_why_and_leaves_nothing(tmp_path):
    """Files of more than a kilobyte are refused: the nearest to a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_psf(tmp_path, np.eye(40))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
