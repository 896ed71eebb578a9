"""Training of the denoiser: first on white noise, then within the restoration that it serves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from cep.restoration.denoiser.network import SCHEMA, DenoisingNetwork
from cep.restoration.plug_and_play import FIRST_SIGMA, MOST_RATIO, PRIOR, STEPS
from lab.trainings.averaged import AveragedNetwork, set_rate
from lab.trainings.denoiser import samples
from lab.trainings.denoiser.samples import Photos, column
from motdiff.weights_io import halved, write_with_card

_WARM_UP_STEPS = 100
_LAST_RATE = 0.01  # of the first, at the end of the cosine
_LAST_WHITE_RATE = 0.1  # of the first: the second half goes on from there
_LONGEST_GRADIENT = 0.5
_AVERAGED = 0.998  # share of the old weights in the running average, once there are enough of them
_BORDER_PX = 8  # of a crop, whose surroundings are its other side
_SMALLEST_ERROR = 1e-9
_SMALLEST_POWER = 1e-12


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes
    ----------
    batch, crop_px : int
        Crops with white noise in an update, and their side.
    blurred_batch, blurred_px : int
        The same of blurred photos.
    rate, blurred_rate : float
        Adam's first step size on white noise, and on blurred photos.
    white : float
        Share of the run on white noise.
    seed : int
    """

    batch: int = 256
    crop_px: int = 96
    blurred_batch: int = 96
    blurred_px: int = 128
    rate: float = 1.5e-3
    blurred_rate: float = 5e-4
    white: float = 0.27
    seed: int = 0


class DenoiserTrainer(AveragedNetwork[DenoisingNetwork]):
    """Network, its optimiser, and the running average of its weights, which is exported.

    Parameters
    ----------
    photos : Photos
    paths : (N, T, 2) float tensor, px
        Motions of the blurred photos, on the photos' device.
    settings : Settings
    """

    def __init__(self, photos: Photos, paths: Tensor, settings: Settings) -> None:
        device = photos.pixels.device
        super().__init__(DenoisingNetwork, seed=settings.seed, device=device, old_share=_AVERAGED)
        self.settings = settings
        self._photos = photos
        self._paths = paths
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._draw = torch.Generator(device).manual_seed(settings.seed)
        self._adam = torch.optim.Adam(self.network.parameters(), lr=settings.rate)
        self._is_half = device.type == "cuda"
        self._scaler = torch.amp.GradScaler("cuda", enabled=self._is_half)

    def update(self, progress: float) -> Tensor:
        """Make one update at a share ``progress`` of the run, 0..1; returns the loss, a scalar."""
        settings = self.settings
        if progress < settings.white:
            rate = settings.rate * _cosine(progress / settings.white, last=_LAST_WHITE_RATE)
            loss = self._white_loss()
        else:
            blurred = (progress - settings.white) / (1 - settings.white)
            rate = settings.blurred_rate * _cosine(blurred, last=_LAST_RATE)
            loss = self._blurred_loss()
        set_rate(self._adam, rate * min(1.0, (self.step + 1) / _WARM_UP_STEPS))
        self._adam.zero_grad()
        torch.autograd.backward(self._scaler.scale(loss))
        self._scaler.unscale_(self._adam)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_GRADIENT)
        self._scaler.step(self._adam)
        self._scaler.update()
        self.advance()
        return loss.detach()

    def restored(self, photos: Tensor, H: Tensor, sigma: Tensor, strength: Tensor) -> Tensor:
        """Restore photos (B, 1, S, S) at periodic borders as the plug-and-play restoration does.

        It is :func:`cep.restoration.plug_and_play.pnp`.

        Parameters
        ----------
        photos : (B, 1, S, S) float
        H : (B, 1, S, S // 2 + 1) complex
            OTFs.
        sigma, strength : (B,) float
            Standard deviation of the noise, and the constant of the scene's spectrum.
        """
        side = photos.shape[-1]
        Y = torch.fft.rfft2(photos)
        power = H.abs().square()
        N = sigma.square()
        wiener = power + column(N / strength) * _power_law(side, photos.device)
        X = H.conj() * Y / wiener.clamp(min=_SMALLEST_POWER)
        first = torch.maximum((MOST_RATIO * sigma).clamp(max=FIRST_SIGMA), sigma)
        z = self._denoised(torch.fft.irfft2(X, (side, side)), first)
        for step in range(1, STEPS):
            level = first * (sigma / first) ** (step / (STEPS - 1))
            a = column(PRIOR * N / level.square())
            X = (H.conj() * Y + a * torch.fft.rfft2(z.clamp(min=0))) / (power + a)
            z = self._denoised(torch.fft.irfft2(X, (side, side)), level)
        return z

    def _white_loss(self) -> Tensor:
        """Mean absolute error over the square root of the noise level: all levels have about the
        same weight.
        """
        settings, draw = self.settings, self._draw
        clean = samples.scenes(self._photos, settings.batch, settings.crop_px, draw)
        sigma = samples.levels(samples.SIGMAS, len(clean), draw)
        noisy = clean + samples.white_noise(clean, sigma, draw)
        error = (self._denoised(noisy, sigma) - clean).abs().mean(dim=(1, 2, 3))
        return (error / sigma.sqrt()).mean()

    def _blurred_loss(self) -> Tensor:
        """Mean logarithm of the error of restored photos: their mean PSNR, in nepers."""
        settings, draw = self.settings, self._draw
        side = settings.blurred_px
        clean = samples.scenes(self._photos, settings.blurred_batch, side, draw)
        psfs, assumed = samples.psfs(self._paths, len(clean), draw)
        H = samples.otfs(psfs, side)
        light = torch.fft.irfft2(H * torch.fft.rfft2(clean), (side, side))
        sigma = samples.levels(samples.BLURRED_SIGMAS, len(clean), draw)
        # photon noise has the variance of the light; its share of the noise is drawn
        photon = samples.uniform((0.0, 1.0), (len(clean), 1, 1, 1), draw)
        relative = light.clamp(min=0) / light.mean(dim=(2, 3), keepdim=True).clamp(min=1e-3)
        spread = (1 - photon + photon * relative).sqrt()
        photos = light + spread * samples.white_noise(light, sigma, draw)
        z = self.restored(photos, samples.otfs(assumed, side), sigma, scene_strength(clean))
        inner = (..., slice(_BORDER_PX, -_BORDER_PX), slice(_BORDER_PX, -_BORDER_PX))
        error = (z[inner] - clean[inner]).square().mean(dim=(1, 2, 3))
        return 0.5 * torch.log(error + _SMALLEST_ERROR).mean()

    def _denoised(self, images: Tensor, sigma: Tensor) -> Tensor:
        half = torch.autocast("cuda", dtype=torch.float16) if self._is_half else nullcontext()
        with half:
            denoised: Tensor = self.network(
                images.contiguous(memory_format=torch.channels_last), sigma
            )
        return denoised.float()


def scene_strength(scenes: Tensor) -> Tensor:
    """Constants A (B,) of the spectra A / f^2, per pixel, of scenes (B, 1, S, S)."""
    side = scenes.shape[-1]
    law = _power_law(side, scenes.device)
    usable = law > (3 / side) ** 2
    window = torch.hann_window(side, device=scenes.device)
    window = window[:, None] * window
    centred = (scenes - scenes.mean(dim=(2, 3), keepdim=True)) * window
    density = torch.fft.rfft2(centred).abs().square() / window.square().sum()
    logs = (density * law)[..., usable].log().clamp(min=-30).mean(dim=(1, 2))
    # the mean logarithm of an exponential variable is Euler's gamma below that of its mean
    strength: Tensor = (logs + 0.5772).exp()
    return strength


def train(
    photos: Photos,
    paths: Tensor,
    target: Path | str,
    *,
    minutes: float,
    settings: Settings = Settings(),
    save_s: float = 60.0,
    clock: Callable[[], float] = time.monotonic,
    report: Callable[[str], None] = lambda _line: None,
) -> int:
    """Train for so many minutes; returns the number of updates.

    Parameters
    ----------
    photos : Photos
    paths : (N, T, 2) float tensor, px
        Motions of the blurred photos, on the photos' device.
    target : path
        Weights file, written every ``save_s`` seconds and at the end, whole each time.
    minutes : float
        Length of the run; it sets the pace at which the step size falls.
    settings : Settings
    save_s : float
        Seconds between files.
    clock : callable
        Seconds.
    report : callable
        Called with a line of progress at every file.

    Raises
    ------
    ValueError
        If ``minutes`` is not above 0 or a photo is smaller than the crops.
    FloatingPointError
        If the loss is not finite.
    """
    if not 0 < minutes < math.inf:
        raise ValueError(f"minutes: must be above 0, got {minutes}")
    trainer = DenoiserTrainer(photos, paths, settings)
    started = saved = moment = clock()
    while moment - started < 60 * minutes:
        loss = trainer.update((moment - started) / (60 * minutes))
        moment = clock()
        if moment - saved >= save_s or moment - started >= 60 * minutes:
            if not loss.isfinite():  # not in each update: it would wait for the GPU
                raise FloatingPointError(
                    f"loss: is {float(loss)} at step {trainer.step}; train with a smaller rate"
                )
            about = {
                "steps": trainer.step,
                "seconds": round(moment - started),
                "settings": asdict(settings),
            }
            weights = halved(trainer.average.state_dict(), source=target)
            write_with_card(weights, target, schema=SCHEMA, card=about)
            report(f"{trainer.step} updates, {moment - started:.0f} s, loss {float(loss):.4f}")
            saved = moment
    return trainer.step


def _cosine(progress: float, *, last: float) -> float:
    return last + (1 - last) * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))


def _power_law(side: int, device: torch.device) -> Tensor:
    """Squared frequencies (S, S // 2 + 1) of the ``rfft2`` grid, (cy/px)^2."""
    fy = torch.fft.fftfreq(side, device=device)
    fx = torch.fft.rfftfreq(side, device=device)
    law: Tensor = fy[:, None] ** 2 + fx**2
    return law
