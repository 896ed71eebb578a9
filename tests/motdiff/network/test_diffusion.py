"""The diffusion process against closed forms, a Gaussian whose denoiser is known exactly, and
diffusers' schedulers."""

import math
import warnings

import pytest
import torch

from motdiff.network.diffusion import (
    cosine_schedule,
    from_signal,
    q_sample,
    samples,
    stpd,
    to_signal,
)

METHODS = ["ddpm", "ddim", "dpm++2m"]
# standard errors: a right sampler fails with probability 7e-6, and the seeds are fixed
LIMIT = 4.5


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def path_map(batch=2, side=16):
    x0 = torch.zeros(batch, 1, side, side)
    x0[:, :, side // 2, 2:-2] = 1
    x0[0, :, 3:9, 5] = 1
    return x0


def soft_denoiser(x, t):
    """Any smooth function of x and t that is not a true denoiser: errors of the sampler show."""
    return torch.tanh(
        0.7 * x + 0.2 * x.roll(1, -1) + 0.3 * torch.cos(t / 150).view(-1, 1, 1, 1).to(x)
    )


def visited(method, steps, *, seed=3, predict=soft_denoiser, dtype=torch.float32):
    """All (t, x_t) that the network is shown, and the result."""
    seen = []

    def recorded(x, t):
        assert t.dtype == torch.int64
        assert t.shape == (2,)
        seen.append((int(t[0]), x.clone()))
        return predict(x, t)

    run = samples(
        recorded,
        (2, 1, 8, 8),
        schedule=cosine_schedule(),
        steps=steps,
        generator=seeded(seed),
        method=method,
        dtype=dtype,
    )
    return seen, list(run)[-1]


@pytest.fixture(scope="module")
def diffusers():
    with warnings.catch_warnings():  # what a test oracle warns of on import is its own business
        warnings.simplefilter("ignore")
        return pytest.importorskip("diffusers")


# ---- schedule


def test_cosine_schedule_is_the_closed_form_until_the_noise_is_clipped():
    a = cosine_schedule(1000).alpha_bar
    f = [math.cos((t / 1000 + 0.008) / 1.008 * math.pi / 2) ** 2 for t in range(1001)]
    expected = torch.tensor([f[t + 1] / f[0] for t in range(999)], dtype=torch.float64)
    torch.testing.assert_close(a[:999], expected, rtol=1e-12, atol=0)
    assert a[999] == pytest.approx(
        f[999] / f[0] * 0.001, rel=1e-9
    )  # beta would be 1: clipped at 0.999
    assert a[999] == pytest.approx(2.4e-9, rel=0.02)
    assert a.dtype == torch.float64


@pytest.mark.parametrize("steps", [10, 1000])
def test_cosine_schedule_is_diffusers(diffusers, steps):
    theirs = diffusers.DDIMScheduler(
        num_train_timesteps=steps, beta_schedule="squaredcos_cap_v2"
    ).alphas_cumprod
    torch.testing.assert_close(
        cosine_schedule(steps).alpha_bar.float(), theirs, rtol=1e-4, atol=1e-7
    )


def test_trailing_timesteps_start_at_pure_noise():
    schedule = cosine_schedule(1000)
    assert schedule.timesteps(1) == (999,)
    assert schedule.timesteps(3) == (999, 666, 332)
    assert schedule.timesteps(1000) == tuple(range(999, -1, -1))
    for steps in range(1, 1001):
        visits = schedule.timesteps(steps)
        assert len(set(visits)) == steps
        assert visits[0] == 999
        assert visits[-1] >= 0


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 10, 50, 333, 1000])
def test_trailing_timesteps_are_diffusers(diffusers, steps):
    theirs = diffusers.DDIMScheduler(num_train_timesteps=1000, timestep_spacing="trailing")
    theirs.set_timesteps(steps)
    assert cosine_schedule().timesteps(steps) == tuple(theirs.timesteps.tolist())


# ---- forward process


def test_signal_range_and_back():
    x0 = torch.tensor([0.0, 0.25, 1.0])
    assert to_signal(x0).tolist() == [-1.0, -0.5, 1.0]
    torch.testing.assert_close(from_signal(to_signal(x0)), x0)


@pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
def test_stpd_drops_each_path_pixel_with_its_probability_and_leaves_the_background(p):
    x0 = torch.zeros(4, 1, 100, 100)
    x0[..., ::4] = 1
    dropped = stpd(x0, p, seeded(1))
    path = x0 == 1
    pixels = int(path.sum())
    rate = 1 - float(dropped[path].mean())
    assert abs(rate - p) < LIMIT * math.sqrt(p * (1 - p) / pixels)
    assert not dropped[~path].any()
    assert set(dropped.unique().tolist()) == {0.0, 1.0}


def test_stpd_drops_pixels_independently():
    ones = torch.ones(200, 200)
    dropped = stpd(ones, 0.3, seeded(2)) - 0.7
    for shift in [(0, 1), (1, 0), (1, 1)]:
        covariance = float((dropped * dropped.roll(shift, (0, 1))).mean())
        assert abs(covariance) < LIMIT * 0.21 / 200


def test_stpd_without_and_with_all_dropout():
    x0 = path_map()
    assert torch.equal(stpd(x0, 0, seeded()), x0)
    assert not stpd(x0, 1, seeded()).any()


def test_noisy_signal_has_the_moments_of_the_forward_process():
    schedule = cosine_schedule()
    t = torch.tensor([0, 200, 500, 800, 999])
    count = 100_000
    signal = torch.full((5, 1, count), 0.6, dtype=torch.float64)
    noise = torch.randn(signal.shape, generator=seeded(4), dtype=torch.float64)
    noisy = q_sample(schedule, signal, t, noise)
    for row, index in zip(noisy, t, strict=True):
        a = float(schedule.alpha_bar[index])
        assert abs(float(row.mean()) - 0.6 * math.sqrt(a)) < LIMIT * math.sqrt((1 - a) / count)
        assert float(row.var()) == pytest.approx(1 - a, rel=LIMIT * math.sqrt(2 / count))


def test_each_sample_gets_the_noise_of_its_own_timestep():
    signal = to_signal(path_map(3))
    noise = torch.randn(3, 1, 16, 16, generator=seeded())
    t = torch.tensor([999, 0, 400])
    together = q_sample(cosine_schedule(), signal, t, noise)
    assert together.dtype == torch.float32
    for i in range(3):
        alone = q_sample(cosine_schedule(), signal[i : i + 1], t[i : i + 1], noise[i : i + 1])
        assert torch.equal(together[i : i + 1], alone)


# ---- sampling


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("steps", [1, 10, 50])
def test_a_denoiser_that_knows_the_map_gives_it_exactly(method, steps):
    truth = to_signal(path_map())
    run = samples(
        lambda x, t: truth,
        truth.shape,
        schedule=cosine_schedule(),
        steps=steps,
        generator=seeded(),
        method=method,
    )
    estimates = list(run)
    assert len(estimates) == steps
    assert torch.equal(from_signal(estimates[-1]), path_map())


@pytest.mark.parametrize("method", ["ddpm", "ddim", "dpm++2m"])
def test_with_the_map_known_the_network_sees_the_forward_process_at_every_timestep(method):
    """For a known x0 each x_t is q_sample of it: the mean is sqrt(a) x0, the variance 1 - a."""
    schedule = cosine_schedule()
    count = 40_000
    seen = []

    def oracle(x, t):
        seen.append((int(t[0]), x))
        return torch.full_like(x, 0.6)

    list(
        samples(
            oracle,
            (1, count),
            schedule=schedule,
            steps=8,
            generator=seeded(5),
            method=method,
        )
    )
    assert [t for t, _ in seen] == list(schedule.timesteps(8))
    for t, x in seen:
        a = float(schedule.alpha_bar[t])
        assert (
            abs(float(x.mean()) - 0.6 * math.sqrt(a)) < LIMIT * math.sqrt((1 - a) / count) + 1e-4
        )
        assert float(x.var()) == pytest.approx(1 - a, rel=LIMIT * math.sqrt(2 / count))


@pytest.mark.parametrize(("method", "steps"), [("ddpm", 1000), ("ddim", 1000), ("dpm++2m", 100)])
def test_samples_of_a_gaussian_have_its_mean_and_variance(method, steps):
    """x0 ~ N(m, s^2): E[x0 | x_t] = m + sqrt(a) s^2 (x_t - sqrt(a) m) / (a s^2 + 1 - a) is the
    perfect denoiser."""
    m = 0.3
    s = 0.4
    count = 20_000
    schedule = cosine_schedule()

    def posterior_mean(x, t):
        a = schedule.alpha_bar[t].view(-1, 1)
        return m + a.sqrt() * s**2 * (x - a.sqrt() * m) / (a * s**2 + 1 - a)

    run = samples(
        posterior_mean,
        (1, count),
        schedule=schedule,
        steps=steps,
        generator=seeded(6),
        method=method,
        dtype=torch.float64,
    )
    *_, drawn = run
    assert abs(float(drawn.mean()) - m) < LIMIT * s / math.sqrt(count)
    assert float(drawn.var()) == pytest.approx(s**2, rel=LIMIT * math.sqrt(2 / count))


@pytest.mark.parametrize("steps", [7, 50, 1000])
def test_ddpm_draws_from_the_posterior(steps):
    """Ho et al. eq. 7, with beta = 1 - a / a' between the visited timesteps: its own form, x0 and
    x_t weighted."""
    ancestral, _ = visited("ddpm", steps, dtype=torch.float64)
    draw = seeded(3)
    torch.randn(2, 1, 8, 8, generator=draw, dtype=torch.float64)  # x_T
    alpha_bar = cosine_schedule().alpha_bar
    for k in range(steps - 1):
        (t, x), (then, following) = ancestral[k : k + 2]
        a = alpha_bar[t]
        b = alpha_bar[then]
        beta = 1 - a / b
        x0 = soft_denoiser(x, torch.full((2,), t))
        mean = b.sqrt() * beta / (1 - a) * x0 + (a / b).sqrt() * (1 - b) / (1 - a) * x
        noise = torch.randn(2, 1, 8, 8, generator=draw, dtype=torch.float64)
        torch.testing.assert_close(
            following, mean + (beta * (1 - b) / (1 - a)).sqrt() * noise, rtol=0, atol=1e-9
        )


COMMON = {
    "beta_schedule": "squaredcos_cap_v2",
    "prediction_type": "sample",
    "timestep_spacing": "trailing",
}


@pytest.mark.parametrize("method", ["ddim", "ddpm"])
@pytest.mark.parametrize("steps", [10, 50])
def test_every_step_is_that_of_diffusers(diffusers, method, steps):
    """In float64: in its own float32, diffusers' first step of ddpm takes 1e-7 as a difference of
    two ones."""
    scheduler = {"ddim": diffusers.DDIMScheduler, "ddpm": diffusers.DDPMScheduler}[method]
    theirs = scheduler(clip_sample=False, **COMMON)
    theirs.alphas_cumprod = cosine_schedule().alpha_bar
    theirs.final_alpha_cumprod = theirs.one = torch.ones((), dtype=torch.float64)
    theirs.set_timesteps(steps)
    ours, result = visited(method, steps, dtype=torch.float64)
    draw = seeded(3)
    x = torch.randn(2, 1, 8, 8, generator=draw, dtype=torch.float64)
    for (t, seen), timestep in zip(ours, theirs.timesteps, strict=True):
        assert t == timestep
        torch.testing.assert_close(seen, x, rtol=0, atol=1e-9)
        x = theirs.step(
            soft_denoiser(x, timestep.repeat(2)), timestep, x, generator=draw
        ).prev_sample
    torch.testing.assert_close(result, x, rtol=0, atol=1e-9)


@pytest.mark.filterwarnings(
    "ignore:__array__:DeprecationWarning"
)  # diffusers hands a tensor to numpy 2
@pytest.mark.parametrize("steps", [10, 50])
def test_every_second_order_step_is_that_of_diffusers(diffusers, steps):
    theirs = diffusers.DPMSolverMultistepScheduler(
        algorithm_type="dpmsolver++", solver_order=2, **COMMON
    )
    theirs.set_timesteps(steps)
    ours, result = visited("dpm++2m", steps)
    x = torch.randn(2, 1, 8, 8, generator=seeded(3))
    for (t, seen), timestep in zip(ours, theirs.timesteps, strict=True):
        assert t == timestep
        torch.testing.assert_close(seen, x, rtol=0, atol=2e-5)
        x = theirs.step(soft_denoiser(x, timestep.repeat(2)), timestep, x).prev_sample
    torch.testing.assert_close(result, x, rtol=0, atol=2e-5)


def test_deterministic_methods_follow_a_gaussians_exact_flow_to_first_and_second_order():
    """For x0 ~ N(m, s^2) the probability flow keeps each element's standard score at all t: x_t is
    known exactly."""
    m = 0.3
    s = 0.4
    schedule = cosine_schedule()

    def error(method, steps):
        scores = []

        def posterior_mean(x, t):
            a = schedule.alpha_bar[t].view(-1, 1)
            scores.append((x - a.sqrt() * m) / (a * s**2 + 1 - a).sqrt())
            return m + a.sqrt() * s**2 * (x - a.sqrt() * m) / (a * s**2 + 1 - a)

        options = {"generator": seeded(), "method": method, "dtype": torch.float64}
        list(samples(posterior_mean, (1, 500), schedule=schedule, steps=steps, **options))
        return float((scores[-1] - scores[0]).abs().mean())

    first, second = (
        [error(method, steps) for steps in (160, 1000)] for method in ("ddim", "dpm++2m")
    )
    assert 4 < first[0] / first[1] < 8  # 6.25 times the steps
    assert second[0] / second[1] > 15
    assert second[0] < first[0] / 5


@pytest.mark.parametrize("method", METHODS)
def test_the_same_seed_draws_the_same_maps(method):
    first, again, other = (visited(method, 10, seed=seed)[1] for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_callers_may_stop_early_and_no_call_is_made_before_the_first_step():
    calls = []

    def predict(x, t):
        calls.append(int(t[0]))
        return x

    run = samples(predict, (1, 1, 4, 4), schedule=cosine_schedule(), steps=10, generator=seeded())
    assert calls == []
    next(run)
    next(run)
    run.close()
    assert calls == [999, 899]


def test_gradients_are_off_inside_and_as_before_outside():
    weight = torch.ones((), requires_grad=True)
    run = samples(
        lambda x, t: weight * x, (1, 4), schedule=cosine_schedule(), steps=3, generator=seeded()
    )
    for estimate in run:
        assert not estimate.requires_grad
        assert torch.is_grad_enabled()


def test_estimates_keep_the_type_asked_for_when_the_network_answers_in_half():
    for dtype in (torch.float32, torch.float64):
        run = samples(
            lambda x, t: x.bfloat16(),
            (1, 4),
            schedule=cosine_schedule(),
            steps=3,
            generator=seeded(),
            dtype=dtype,
        )
        assert {estimate.dtype for estimate in run} == {dtype}


def test_noise_comes_from_the_generators_device_and_work_is_done_on_the_one_asked_for():
    """The meta device stands in for a GPU: what is computed on the wrong device raises."""
    run = samples(
        lambda x, t: x,
        (1, 4),
        schedule=cosine_schedule(),
        steps=3,
        generator=seeded(),
        method="ddpm",
        device="meta",
    )
    assert {estimate.device.type for estimate in run} == {"meta"}
    x0 = torch.zeros(2, 4, device="meta")
    assert stpd(x0, 0.5, seeded()).device.type == "meta"
    assert (
        q_sample(
            cosine_schedule(), x0, torch.zeros(2, dtype=torch.int64, device="meta"), x0
        ).device.type
        == "meta"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "euler"}, r"^method must be one of ddpm, ddim, dpm\+\+2m; got 'euler'$"),
        ({"steps": 0}, r"^steps must be 1\.\.1000, the schedule's timesteps; got 0$"),
        ({"steps": 1001}, r"^steps must be 1\.\.1000, the schedule's timesteps; got 1001$"),
    ],
)
def test_bad_options_are_refused_at_the_call(options, message):
    arguments = {"schedule": cosine_schedule(), "steps": 10, "generator": seeded()} | options
    with pytest.raises(ValueError, match=message):
        samples(lambda x, t: x, (1, 1, 4, 4), **arguments)
