"""The constrained fit against dense linear algebra and its optimality conditions."""

import numpy as np
import pytest
from scipy import ndimage, optimize, signal

from motdiff.estimators.reference.psf_fit import (
    PatchPair,
    fit_psf,
    residual_variance,
)
from motdiff.motions import boracchi_foi

SIZE = 7


def pair(seed: int, *, noise: float = 0.05, masked: bool = True) -> tuple[PatchPair, np.ndarray]:
    rng = np.random.default_rng(seed)
    sharp = ndimage.gaussian_filter(rng.standard_normal((40, 45)), 0.7)
    psf = np.maximum(rng.standard_normal((SIZE, SIZE)), 0)
    psf /= psf.sum()
    blurred = signal.convolve(sharp, psf, mode="valid") + noise * rng.standard_normal((34, 39))
    weight = (rng.random(blurred.shape) > 0.2) * 1.0 if masked else np.ones(blurred.shape)
    return PatchPair(sharp, blurred, weight), psf


def dense(pairs: list[PatchPair]) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side of the weighted problem, column by column through scipy's
    convolution."""
    columns = []
    for index in range(SIZE * SIZE):
        unit = np.zeros(SIZE * SIZE)
        unit[index] = 1
        columns.append(
            np.concatenate(
                [
                    (
                        np.sqrt(p.weight)
                        * signal.convolve(p.sharp, unit.reshape(SIZE, SIZE), mode="valid")
                    ).ravel()
                    for p in pairs
                ]
            )
        )
    return np.array(columns).T, np.concatenate(
        [(np.sqrt(p.weight) * p.blurred).ravel() for p in pairs]
    )


@pytest.mark.parametrize("seeds", [(0,), (1, 2)])
def test_equals_scipys_nnls(seeds: tuple[int, ...]) -> None:
    pairs = [pair(seed)[0] for seed in seeds]
    matrix, values = dense(pairs)
    expected, _ = optimize.nnls(matrix, values)
    np.testing.assert_allclose(fit_psf(pairs, SIZE).ravel(), expected, atol=2e-3 * expected.max())


def test_optimality_with_the_prior() -> None:
    pairs = [pair(3)[0]]
    sparse = 1.0
    matrix, values = dense(pairs)
    psf = fit_psf(pairs, SIZE, sparse=sparse).ravel()
    gradient = matrix.T @ (matrix @ psf - values) + sparse
    scale = np.abs(matrix.T @ values).max()
    assert psf.min() >= 0
    assert np.abs(gradient[psf > 0]).max() < 2e-3 * scale
    assert gradient[psf == 0].min() > -2e-3 * scale
    assert (psf == 0).any()


def test_where_it_starts_does_not_matter() -> None:
    pairs = [pair(4)[0]]
    truth = pair(4)[1]
    from_zero = fit_psf(pairs, SIZE)
    np.testing.assert_allclose(
        fit_psf(pairs, SIZE, start=truth), from_zero, atol=3e-3 * from_zero.max()
    )


def test_masked_pixels_do_not_count() -> None:
    good, psf = pair(5, noise=0.0)
    spoiled = PatchPair(good.sharp, np.where(good.weight > 0, good.blurred, 1e3), good.weight)
    np.testing.assert_allclose(fit_psf([spoiled], SIZE), psf, atol=2e-3 * psf.max())
    assert residual_variance([spoiled], psf) == pytest.approx(0, abs=1e-20)
    variance = (good.weight * good.blurred**2).sum() / good.pixels
    assert residual_variance([spoiled], np.zeros((SIZE, SIZE))) == pytest.approx(variance)


def test_a_large_frame_on_a_red_scene() -> None:
    # 1/f^2 scenes make the problem ill-conditioned; the truth is known and there is no noise
    rng = np.random.default_rng(0)
    fy, fx = np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256), indexing="ij")
    scene = np.fft.ifft2(
        np.fft.fft2(rng.standard_normal((256, 256))) / (0.02 + np.hypot(fx, fy))
    ).real
    psf = boracchi_foi(rng, max_length_px=30).psf(32)
    exact = PatchPair(scene, signal.fftconvolve(scene, psf, mode="valid"), np.ones((225, 225)))
    found = fit_psf([exact], 32)
    assert np.linalg.norm(found - psf) < 0.05 * np.linalg.norm(psf)
