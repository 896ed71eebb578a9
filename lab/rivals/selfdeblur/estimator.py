"""SelfDeblur as a resumable estimator (hours on a CPU)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from lab.rivals.selfdeblur.config import SelfDeblurConfig
from lab.rivals.selfdeblur.fit import JointFit
from motdiff.crops import best_windows
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.description import estimate_from_kernel
from motdiff.photo_values import textured_luminance

_LEAST_PX = 32
_SAVED_EVERY_S = 60.0
_FITTING = tuple(
    Path(__file__).with_name(f"{name}.py") for name in ("config", "estimator", "fit", "generators")
)


class SelfDeblurEstimator:
    """Blind estimator without training: SelfDeblur's two generators, fitted to each photo anew.

    A photo of 256 x 256 px takes 5000 iterations of about 2.6 CPU-s.

    Parameters
    ----------
    config : SelfDeblurConfig, optional
        The published recipe when omitted.
    checkpoints : path, optional
        Folder, made where it is missing, that keeps the state of each unfinished photo; the same
        photo goes on from there, exactly. A finished photo leaves nothing (in between, up to 80
        MB). Not resumable when omitted.
    saved_every_s : float, seconds
        Least time between two checkpoints.
    device : str
        Torch device of the fit.
    progress : callable, optional
        Called with the finished share 0..1.

    References
    ----------
    Ren, Zhang, Wang, Hu, Zuo, "Neural blind deconvolution using deep priors", CVPR 2020.
    """

    def __init__(
        self,
        *,
        config: SelfDeblurConfig | None = None,
        checkpoints: Path | str | None = None,
        saved_every_s: float = _SAVED_EVERY_S,
        device: str = "cpu",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._config = SelfDeblurConfig() if config is None else config
        self._checkpoints = None if checkpoints is None else Path(checkpoints)
        self._saved_every_s = saved_every_s
        self._device = device
        self._progress = progress

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Fit the kernel of ``photo``, (H, W) or (H, W, 3), linear light 0..1; of a large one, of
        its best crop.

        Its centroid lies at index 32, to whole pixels. The fit is not scored: ``confidence`` is 0.
        Processor time before a resumed checkpoint is ``details["earlier_cpu_s"]``.

        Raises
        ------
        ValueError
            If the photo is smaller than 32 x 32 px, not finite, or without texture, or a
            checkpoint is spoilt.
        OSError
            If a checkpoint cannot be written.
        """
        began_s = time.process_time()
        earlier_s = 0.0
        grey = textured_luminance(photo, least_px=_LEAST_PX)
        window = grey[best_windows(grey, count=1)[0]]
        fit = JointFit(torch.from_numpy(window.astype(np.float32)).to(self._device), self._config)
        file = self._file(window)
        if file is not None:
            earlier_s = fit.resume(file) or 0.0
        saved_s = time.monotonic()
        loss = None
        while fit.iteration < self._config.iterations:
            loss = fit.advance()
            if file is not None and time.monotonic() - saved_s >= self._saved_every_s:
                fit.save(file, cpu_s=earlier_s + time.process_time() - began_s)
                saved_s = time.monotonic()
            if self._progress is not None:
                self._progress(fit.iteration / self._config.iterations)
        details = {
            "iterations": fit.iteration,
            "loss": loss,
            "kernel_px": self._config.kernel_px,
            "earlier_cpu_s": earlier_s,
        }
        estimate = estimate_from_kernel("selfdeblur", fit.kernel().double().numpy(), details)
        if file is not None:
            file.unlink(missing_ok=True)
        return estimate

    def _file(self, window: NDArray[np.float64]) -> Path | None:
        """File of this photo's checkpoint: another photo, recipe, size or code is another
        one.
        """
        if self._checkpoints is None:
            return None
        what = hashlib.sha256(f"{_code_version()} {self._config} {window.shape}".encode())
        what.update(np.ascontiguousarray(window).tobytes())
        return self._checkpoints / what.hexdigest()[:24]


def _code_version() -> str:
    """Fingerprint of the source code of the fit: a checkpoint is resumed by the same code only."""
    what = hashlib.sha256(torch.__version__.encode())
    for path in _FITTING:
        what.update(path.read_bytes())
    return what.hexdigest()
