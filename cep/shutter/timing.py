"""When a camera exposes: flashes of a coded light swept across its exposure, as a stopwatch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cep.optics.camera import Camera as NoiseModel
from cep.plots.camera import exposure_window_figure
from cep.plots.canvas import save as save_figure
from cep.shutter.exposure_fit import ExposureTiming, Flashes
from cep.shutter.exposure_plan import Release, checked_release
from cep.shutter.exposure_sweep import MOST_FRAMES, Exposed, ExposureSweep, Flash, flash_program
from cep.shutter.play import LEASE_MS
from cep.shutter.rig import Rig
from cep.shutter.shoot import open_rig
from hw.cameras.camera import CameraSettings, Trigger

BUSY_LATE_NS = 2_750
"""The output "busy" of an Uno rises so long after the controller's trigger."""
_SHORTEST_FLASH_S = 50e-6
_READY_S = 2.0
_READOUT_S = 3.0
_CLIPPED_SHARE = 1e-3  # of a row
_BLACK_SHARE = 0.05
_BLACK_CLIPPED = (
    "dark pixels are cut at code value 0, which shortens the exposure: raise the camera's black"
    " level, or take more light"
)


@dataclass(frozen=True, kw_only=True)
class TimedCamera:
    """A camera whose exposure was timed.

    Attributes
    ----------
    stated_s : float
        Exposure that the camera states.
    release : str
        Who begins an exposure, which start is measured from.
    dead_s : float or None
        Two frames followed each other with so little time between their exposures, or less; None
        where the camera has no clock.
    """

    timing: ExposureTiming
    flashes: Flashes
    stated_s: float
    release: str
    dead_s: float | None
    camera: str
    serial: str
    frames: int
    warnings: tuple[str, ...] = ()

    def profile(self, measured: NoiseModel | None = None) -> NoiseModel:
        """Return a camera with the times, for ``--camera`` of the commands and ``--lead-in``."""
        timing = self.timing
        base = measured or NoiseModel(name=self.camera, source="noise not measured")
        return replace(
            base,
            name=base.name or self.camera,
            trigger_delay_s=timing.start.value,
            trigger_jitter_s=timing.jitter.upper,
            readout_s=timing.readout_s,
            exposure_offset_s=timing.length.value - self.stated_s,
        )

    def to_dict(self) -> dict[str, object]:
        """Fields for JSON: whole nanoseconds, each with its interval."""
        timing = self.timing
        figures: dict[str, object] = {"camera": self.camera, "serial": self.serial}
        for name, interval in (
            ("delay", timing.start),
            ("length", timing.length),
            ("jitter", timing.jitter),
            ("row", timing.row),
        ):
            digits = 3 if name in ("jitter", "row") else 0
            figures[f"{name}_ns"] = round(1e9 * interval.value, digits)
            bounds = (interval.lower, interval.upper)
            figures[f"{name}_interval_ns"] = [round(1e9 * bound, digits) for bound in bounds]
        return figures | {
            "stated_ns": round(1e9 * self.stated_s),
            "readout_ns": round(1e9 * timing.readout_s),
            "dead_ns": None if self.dead_s is None else [0, round(1e9 * self.dead_s)],
            "light_energy_sigma": timing.energy,
            "release": self.release,
            "frames": self.frames,
            "warnings": list(self.warnings),
        }

    def save_figure(self, path: Path) -> None:
        """Draw the exposure window under the flashes."""
        timing = self.timing
        table = self.flashes
        dark = table.brightness[:2, 0].mean()
        rate = np.median(
            [
                (rows[0] - dark) / float(np.diff(pulses, axis=1).sum())
                for rows, pulses in zip(table.brightness[-2:], table.pulses_s[-2:], strict=True)
            ]
        )
        single = [index for index, pulses in enumerate(table.pulses_s) if len(pulses) == 1]
        pulses_s = np.array([table.pulses_s[index][0] for index in single])
        light_s = (table.brightness[single, 0] - dark) / rate
        figure = exposure_window_figure(
            pulses_s,
            light_s / np.diff(pulses_s, axis=1)[:, 0],
            start_s=(timing.start.value, timing.start.lower, timing.start.upper),
            length_s=(timing.length.value, timing.length.lower, timing.length.upper),
        )
        save_figure(figure, path)


def time_camera(
    camera: str,
    *,
    port: str | None = None,
    exposure_s: float = 0.002,
    gain_db: float | None = None,
    release: Release | None = None,
    progress: Callable[[float, str], None] = lambda _share, _text: None,
) -> TimedCamera:
    """Measure when a camera exposes, by flashes of the controller's light.

    Parameters
    ----------
    camera : str
        As of :func:`cep.shutter.shoot.shoot`, as is ``port``.
    exposure_s : float
        That is set.
    release : Release, optional
        ``shutter``: the controller's output "busy" triggers the camera; ``camera``: the camera's
        output "exposure active" triggers the controller. The first where both can.
    progress : callable
        Called with the share of frames that are taken.

    Raises
    ------
    ValueError
        If there is no such camera or controller, or it cannot expose so. Nothing was armed.
    CameraError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
        If they fail, or the light is not seen, clips or is too faint. The shutter is closed.

    Examples
    --------
    ::

        timed = time_camera("pylon:", port="/dev/ttyACM0", exposure_s=0.005)
        print(timed.timing.start)
    """
    with open_rig(camera, port) as rig:
        bench = _Bench(rig, exposure_s=exposure_s, gain_db=gain_db, release=release)
        sweep = ExposureSweep(
            lambda flash: bench.expose(flash, progress),
            length_s=bench.stated_s,
            flash_s=max(_SHORTEST_FLASH_S, bench.limits.min_ticks * bench.limits.tick_ns * 1e-9),
            earliest_s=bench.limits.lead_ns * 1e-9,
        )
        timing, flashes = sweep.run()
    starts_ns = [frame_ns for frame_ns in bench.starts_ns if frame_ns is not None]
    gaps_ns = np.diff(starts_ns)
    return TimedCamera(
        timing=timing,
        flashes=flashes,
        stated_s=bench.stated_s,
        release=str(bench.release),
        dead_s=float(gaps_ns.min()) * 1e-9 - timing.length.value if len(gaps_ns) else None,
        camera=bench.camera,
        serial=bench.serial,
        frames=sweep.taken,
        warnings=(_BLACK_CLIPPED,) if bench.black_share > _BLACK_SHARE else (),
    )


class _Bench:
    """A camera and a controller, set for frames under flashes."""

    def __init__(
        self, rig: Rig, *, exposure_s: float, gain_db: float | None, release: Release | None
    ) -> None:
        if rig.controller is None:
            raise ValueError(f"camera: {rig.camera.name}: has no exposure that could be timed")
        self._camera, self._controller = rig.camera, rig.controller
        announced = rig.controller.announced
        self.release = checked_release(
            rig.camera.triggers, rig.camera.name, announced.firmware, release
        )
        if self.release not in (Release.SHUTTER, Release.CAMERA):
            raise ValueError(f"release: must be shutter or camera, got {self.release}")
        self._fires = self.release is Release.CAMERA
        late_ns = 0 if self._fires else BUSY_LATE_NS
        self.limits = replace(announced, lead_ns=announced.lead_ns - late_ns)
        trigger = Trigger.SOFTWARE if self._fires else Trigger.LINE
        settings = rig.camera.configure(
            CameraSettings(exposure_s=exposure_s, trigger=trigger, gain_db=gain_db)
        )
        self.stated_s = settings.exposure_s
        self.starts_ns: list[int | None] = []
        self.camera = self.serial = ""
        self.black_share = 0.0  # of the pixels at code value 0 in the first frame, a dark one

    def expose(self, flash: Flash, progress: Callable[[float, str], None]) -> Exposed:
        """Take a frame under a flash."""
        program = flash_program(flash, self.limits)
        controller, camera = self._controller, self._camera
        controller.upload(program)
        with controller.link.aborted_on_error():
            camera.arm()
            camera.wait_ready(_READY_S)
            controller.arm(lease_ms=LEASE_MS)
            if self._fires:
                camera.fire()
            else:
                controller.trigger()
            controller.wait(timeout_s=program.duration_ns * 1.1e-9 + 2)
            frame = camera.read(self.stated_s + _READOUT_S)
        if not self.starts_ns:
            self.black_share = float(np.mean(frame.values == 0))
        self.starts_ns.append(frame.timestamp_ns)
        self.camera, self.serial = frame.camera, frame.serial
        progress(len(self.starts_ns) / MOST_FRAMES, f"frame {len(self.starts_ns)}")
        times_ns = np.array([edge_ns for edge_ns, _ in program.edges]) + self.limits.lead_ns
        values = frame.values.reshape(len(frame.values), -1)
        clipped = (values >= 2**frame.bits - 1).mean(axis=1) > _CLIPPED_SHARE
        brightness = values.mean(axis=1, dtype=np.float64)
        return Exposed(1e-9 * times_ns.reshape(-1, 2), brightness, clipped)
