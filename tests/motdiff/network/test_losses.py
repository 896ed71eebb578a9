"""The losses against a case worked out by hand, plain cross-entropy, finite differences and their
invariances."""

import math

import numpy as np
import pytest
import torch
from torch.nn import functional

from motdiff.network.diffusion import (
    denoising_loss,
    dwell_loss,
    structure_loss,
    weighted_bce,
    weighted_iou,
)

# p = sigmoid(log 3) = 3/4, sigmoid(-log 3) = 1/4, sigmoid(0) = 1/2
SURE = math.log(3)
HAND_LOGITS = torch.tensor(
    [[[[-SURE, -SURE, 0], [SURE, SURE, 0], [-SURE, -SURE, SURE]]]], dtype=torch.float64
)
HAND_MAP = torch.tensor([[[[0.0, 0, 0], [1, 1, 1], [0, 0, 0]]]], dtype=torch.float64)


def random_case(batch=3, side=12, *, dtype=torch.float64, seed=0):
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(batch, 1, side, side, generator=generator, dtype=torch.float64)
    x0 = (torch.rand(batch, 1, side, side, generator=generator) < 0.15).to(torch.float64)
    dwell = torch.rand(batch, 1, side, side, generator=generator, dtype=torch.float64) * x0
    dwell = dwell / (dwell.sum(dim=(2, 3), keepdim=True) / x0.sum(dim=(2, 3), keepdim=True))
    return logits.to(dtype), x0.to(dtype), dwell.to(dtype)


LOSSES = {
    "structure": lambda logits, x0, dwell: structure_loss(logits, x0, path_weight=4),
    "entropy": lambda logits, x0, dwell: structure_loss(logits, x0, path_weight=0, iou=0),
    "denoising": lambda logits, x0, dwell: denoising_loss(logits, x0),
    "dwell": lambda logits, x0, dwell: dwell_loss(logits, dwell, x0),
}
each_loss = pytest.mark.parametrize("loss", list(LOSSES.values()), ids=list(LOSSES))


# ---- structure


def test_structure_loss_of_a_case_worked_out_by_hand():
    """Weight 5 on the 3 path pixels, 1 on the 6 others: sum(w) = 21.

    Cross-entropy: path log(4/3), log(4/3), log 2; background 4 times log(4/3), once log 2, once
    log 4. Weighted: 5 (2 log(4/3) + log 2) + 4 log(4/3) + log 2 + log 4 = 14 log(4/3) + 8 log 2 =
    9.572727, over 21. Intersection: 5 (3/4 + 3/4 + 1/2) = 10. Total: 5 (2 + 3) + (4/4 + 1/2 + 3/4)
    = 27.25.
    """
    bce = 0.4558441
    iou = 1 - 11 / 18.25  # (10 + 1) / (27.25 - 10 + 1)
    weight = 4 * HAND_MAP + 1
    assert weighted_bce(HAND_LOGITS, HAND_MAP, weight).item() == pytest.approx(bce, abs=1e-7)
    assert weighted_iou(HAND_LOGITS, HAND_MAP, weight).item() == pytest.approx(iou, abs=1e-12)
    assert structure_loss(HAND_LOGITS, HAND_MAP, path_weight=4).item() == pytest.approx(
        bce + iou, abs=1e-7
    )


def test_cross_entropy_is_the_plain_mean_only_without_a_path_weight():
    """The bug of F3Net's code makes these equal for any weight."""
    logits, x0, _ = random_case()
    plain = functional.binary_cross_entropy_with_logits(logits, x0, reduction="none").mean(
        dim=(1, 2, 3)
    )
    torch.testing.assert_close(weighted_bce(logits, x0, torch.ones_like(x0)), plain)
    for path_weight in (1, 5, 20):
        weighted = weighted_bce(logits, x0, path_weight * x0 + 1)
        assert float((weighted - plain).abs().min()) > 1e-3


def test_a_missed_path_costs_more_the_heavier_it_weighs():
    _, x0, _ = random_case()
    background = torch.full_like(x0, -3)
    costs = [float(structure_loss(background, x0, path_weight=weight)) for weight in (0, 1, 5, 20)]
    assert costs == sorted(costs)
    assert costs[-1] > 2 * costs[0]


def test_batch_loss_is_the_mean_of_its_samples_losses():
    """Each sample is normalised by its own weights: a long path does not drown a short one."""
    logits, x0, _ = random_case()
    x0[0] = 1
    x0[1] = 0
    alone = [structure_loss(logits[i : i + 1], x0[i : i + 1], path_weight=4) for i in range(3)]
    torch.testing.assert_close(
        structure_loss(logits, x0, path_weight=4), torch.stack(alone).mean()
    )


def test_without_weights_it_is_the_plain_cross_entropy():
    logits, x0, _ = random_case()
    plain = functional.binary_cross_entropy_with_logits(logits, x0)
    torch.testing.assert_close(structure_loss(logits, x0, path_weight=0, iou=0), plain)
    assert float(structure_loss(logits, x0, path_weight=0)) > float(plain) + 0.1


def test_the_weight_of_the_intersection_over_union():
    """0.4558441 + iou (1 - 11 / 18.25), the case worked out above; 1 unless given."""
    for iou in (0, 0.25, 3):
        expected = 0.4558441 + iou * (1 - 11 / 18.25)
        assert structure_loss(
            HAND_LOGITS, HAND_MAP, path_weight=4, iou=iou
        ).item() == pytest.approx(expected, abs=1e-7)
    assert torch.equal(
        structure_loss(HAND_LOGITS, HAND_MAP, path_weight=4, iou=1),
        structure_loss(HAND_LOGITS, HAND_MAP, path_weight=4),
    )


@pytest.mark.parametrize(("path_weight", "best"), [(0, 0.3), (5, 1.8 / (1.8 + 0.7))])
def test_only_without_weights_the_best_guess_is_the_posterior_mean(path_weight, best):
    """Of ten photos alike, three have their path at the first pixel and seven at the second."""
    here = torch.arange(10) < 3
    maps = torch.zeros(10, 1, 1, 4, dtype=torch.float64)
    maps[here, 0, 0, 0], maps[~here, 0, 0, 1] = 1, 1
    guesses = torch.linspace(0.01, 0.99, 99, dtype=torch.float64)
    costs = []
    for guess in guesses:
        logits = torch.logit(
            torch.tensor([float(guess), 0.7, 1e-9, 1e-9], dtype=torch.float64)
        ).expand(10, 1, 1, 4)
        costs.append(float(structure_loss(logits, maps, path_weight=path_weight, iou=0)))
    assert float(guesses[int(np.argmin(costs))]) == pytest.approx(best, abs=0.01)


# ---- denoising and dwell


def test_denoising_loss_is_the_squared_error_of_the_signal():
    """4 (p - x0)^2: 1/4 where p is 1/4 away from the map (6 pixels), 1 where 1/2 away (2), 9/4
    where 3/4 away (1)."""
    assert denoising_loss(HAND_LOGITS, HAND_MAP).item() == pytest.approx(
        (6 / 4 + 2 + 9 / 4) / 9, abs=1e-12
    )


def test_dwell_loss_of_a_case_worked_out_by_hand():
    """softplus(0) = log 2. Dwell 1/2, 1/2, 2: two small errors, 0.5 e^2, and one above 1, |e| -
    0.5."""
    dwell = torch.tensor([[[[9.0, 9, 9], [0.5, 0.5, 2], [9, 9, 9]]]], dtype=torch.float64)
    expected = ((math.log(2) - 0.5) ** 2 + (2 - math.log(2)) - 0.5) / 3
    assert dwell_loss(torch.zeros_like(dwell), dwell, HAND_MAP).item() == pytest.approx(
        expected, abs=1e-12
    )


def test_dwell_loss_does_not_look_off_the_path():
    logits, x0, dwell = random_case()
    elsewhere = torch.where(x0 == 1, dwell, torch.full_like(dwell, math.nan))
    noisy = torch.where(x0 == 1, logits, 10 * logits).requires_grad_()
    loss = dwell_loss(noisy, elsewhere, x0)
    torch.testing.assert_close(loss, dwell_loss(logits, dwell, x0))
    (gradient,) = torch.autograd.grad(loss, noisy)
    assert not gradient[x0 == 0].any()
    assert gradient[x0 == 1].all()


def test_a_sample_without_a_path_adds_nothing_to_the_dwell_loss():
    logits, x0, dwell = random_case(2)
    alone = dwell_loss(logits[:1], dwell[:1], x0[:1])
    x0[1] = 0
    torch.testing.assert_close(dwell_loss(logits, dwell, x0), alone / 2)
    logits = logits[1:].requires_grad_()
    loss = dwell_loss(logits, dwell[1:], x0[1:])
    assert loss.item() == 0
    (gradient,) = torch.autograd.grad(loss, logits)
    assert not gradient.any()


# ---- what all of them keep


def test_perfect_logits_cost_nothing():
    _, x0, dwell = random_case()
    certain = 40 * (2 * x0 - 1)
    assert float(structure_loss(certain, x0, path_weight=4)) == pytest.approx(0, abs=1e-12)
    assert float(denoising_loss(certain, x0)) == pytest.approx(0, abs=1e-12)
    exact = torch.log(torch.expm1(dwell.clamp(min=1e-6)))  # the inverse of softplus
    assert float(dwell_loss(exact, dwell, x0)) == pytest.approx(0, abs=1e-10)


@each_loss
def test_gradients_are_those_of_finite_differences(loss):
    logits, x0, dwell = random_case(2, 5)
    assert torch.autograd.gradcheck(
        lambda values: loss(values, x0, dwell), logits.requires_grad_()
    )


@each_loss
@pytest.mark.parametrize("sure", [-200.0, 200.0])
def test_very_sure_logits_give_finite_losses_and_gradients(loss, sure):
    _, x0, dwell = random_case(dtype=torch.float32)
    logits = torch.full_like(x0, sure, requires_grad=True)
    value = loss(logits, x0, dwell)
    (gradient,) = torch.autograd.grad(value, logits)
    assert value.isfinite()
    assert gradient.isfinite().all()


@each_loss
@pytest.mark.parametrize(
    "dims", [(2,), (3,), (2, 3), (0,)], ids=["up-down", "left-right", "both", "batch"]
)
def test_flips_of_everything_change_nothing(loss, dims):
    case = random_case()
    torch.testing.assert_close(loss(*(tensor.flip(dims) for tensor in case)), loss(*case))


@each_loss
@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_single(loss, half):
    logits, x0, dwell = random_case(1, 256, dtype=torch.float32)
    logits = logits.to(half)
    value = loss(logits, x0, dwell)
    assert value.dtype == torch.float32
    assert torch.equal(value, loss(logits.float(), x0, dwell))
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(loss(logits, x0, dwell), value)
        assert loss(logits.float(), x0, dwell).dtype == torch.float32


@each_loss
def test_maps_without_the_channel_axis_are_refused(loss):
    """(B, H, W) would broadcast against (B, 1, H, W) and compare each sample with all maps."""
    logits, x0, dwell = random_case()
    message = r"^logits must be shaped like the target, \(3, 12, 12\); got \(3, 1, 12, 12\)$"
    with pytest.raises(ValueError, match=message):
        loss(logits, x0[:, 0], dwell[:, 0])
