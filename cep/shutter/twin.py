"""Twin of a camera: a scene along a motion, integrated over the pins of an emulated controller."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from cep.files.images import read_image
from cep.optics.camera import Camera as NoiseModel
from cep.optics.timeline import extended
from cep.photographs.scenes import NAMES, photographs
from hw.cameras.camera import Camera, CameraError, CameraSettings, Frame, FrameLostError, Trigger
from hw.emulation.uno import CLOCK_HZ, EmulatedUno, EmulationError
from motdiff.path_psfs import interpolated, slice_psfs
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_CYCLE_S = 1 / CLOCK_HZ
_LOOK_S = 0.001  # between two questions for the board's pins
_BLACK_DN = 64.0
_BITS = 12
_REST = 1e4  # durations of the motion before and after it, in which the scene is at rest
_LATEST_S = 10.0  # by which a busy computer's board may lag behind

Answer = TypeVar("Answer")


@dataclass(frozen=True, kw_only=True)
class TwinOptions:
    """What the address of a twin sets, as ``scene=cat,delay_us=300``.

    Attributes
    ----------
    scene : str
        One of the bundled photographs, or a photo's path.
    camera : str
        Noise model, as ``cep camera list`` shows them; a plain one of 12 bits when empty.
    photons : float
        Photo-electrons at full scale.
    delay_us, jitter_us : float
        From the edge at the trigger input to the start of exposure: mean, standard deviation.
    row_us : float
        From the start of one row to that of the next; 0 is a global shutter.
    belt_hz : float
        Light barrier at the controller's trigger input, pulses a second; none at 0.
    """

    scene: str = "camera"
    camera: str = ""
    photons: float = 10_000.0
    delay_us: float = 50.0
    jitter_us: float = 1.0
    row_us: float = 0.0
    belt_hz: float = 0.0
    seed: int = 0

    @classmethod
    def parse(cls, address: str) -> Self:
        """Read the address of a twin; a ValueError names what is not known."""
        values: dict[str, str | float | int] = {}
        types = {name: type(value) for name, value in vars(cls()).items()}
        for item in filter(None, address.split(",")):
            name, equals, text = item.partition("=")
            if name not in types or not equals:
                names = ", ".join(f"{name}=" for name in types)
                raise ValueError(
                    f"camera: twin has no {item[:40]!r}; known are {names}, divided by commas"
                )
            try:
                values[name] = types[name](text)
            except ValueError:
                raise ValueError(
                    f"camera: {name} of the twin must be a number, got {text!r}"
                ) from None
        options = cls(**values)  # type: ignore[arg-type]
        for name in ("photons", "delay_us", "jitter_us", "row_us", "belt_hz", "seed"):
            if not 0 <= getattr(options, name) < 1e9:
                raise ValueError(
                    f"camera: {name} of the twin must be 0 or more, got {getattr(options, name):g}"
                )
        return options

    def noise_model(self) -> NoiseModel:
        """Return the noise model at the light level."""
        if self.camera:
            return NoiseModel.load(self.camera).at(self.photons)
        steps = 2**_BITS - 1 - _BLACK_DN
        return NoiseModel(
            photons_full_scale=self.photons,
            bits=_BITS,
            black_level=_BLACK_DN / steps,
            gain_e_per_dn=self.photons / steps,
        )

    def light(self) -> FloatArray:
        """Return the scene in linear light, (H, W) or (H, W, 3)."""
        if self.scene in NAMES:
            return photographs()[NAMES.index(self.scene)]
        if not Path(self.scene).is_file():
            raise ValueError(
                f"camera: scene {self.scene[:40]!r} is no file, and none of {', '.join(NAMES)}"
            )
        return read_image(self.scene)


@dataclass(frozen=True, kw_only=True)
class MovingScene:
    """A scene before a sensor, along a motion. Times are seconds after the trigger.

    Attributes
    ----------
    light : (H, W) or (H, W, 3) float ndarray, linear light
        That would be recorded at rest with the shutter open for ``duration_s``.
    motion : Trajectory or None
        None: the scene rests.
    start_s, duration_s : float
        Of the motion. Before and after it goes on as :func:`cep.optics.timeline.extended` has it.
    """

    light: FloatArray
    motion: Trajectory | None = None
    start_s: float = 0.0
    duration_s: float = 1.0

    @property
    def rows(self) -> int:
        """Rows of the sensor, which sees less than the scene: light comes in from beyond it."""
        return int(self.light.shape[0] - self._frame_px + 1)

    def collected(
        self, openings_s: FloatArray, *, start_s: float, end_s: float, row_s: float = 0.0
    ) -> FloatArray:
        """Light (H, W) or (H, W, 3) that the sensor collects while the shutter is open.

        The openings (P, 2) are times of opening and closing, start and end those of the first
        row's exposure; each row is later than the one before by ``row_s``.
        """
        late_s = row_s * np.arange(self.rows)[:, None, None]
        # (rows, P, 2): the openings, as far as each row was exposed
        exposed_s = np.clip(openings_s, start_s + late_s, end_s + late_s)
        exposed_s[exposed_s[:, :, 0] == exposed_s[:, :, 1]] = 0.0  # before or after it
        is_first = np.ones(self.rows, dtype=bool)
        is_first[1:] = np.any(exposed_s[1:] != exposed_s[:-1], axis=(1, 2))
        bounds = [*np.flatnonzero(is_first).tolist(), self.rows]
        bands = [self._band(exposed_s[row], row, end_row) for row, end_row in pairwise(bounds)]
        return np.concatenate(bands)

    @property
    def _frame_px(self) -> int:
        return 1 if self.motion is None else self.motion.frame_size() | 1

    def _band(self, openings_s: FloatArray, row: int, end_row: int) -> FloatArray:
        """Light of rows that are exposed alike."""
        open_s = float((openings_s[:, 1] - openings_s[:, 0]).sum())
        if self.motion is None or open_s == 0:
            width = self.light.shape[1] - self._frame_px + 1
            return self.light[row:end_row, :width] * (open_s / self.duration_s)
        kernel = self._kernel(openings_s)
        beyond_px = (len(kernel) - self._frame_px) // 2
        margins = [(beyond_px, beyond_px)] * 2 + [(0, 0)] * (self.light.ndim - 2)
        scene = np.pad(self.light, margins, mode="symmetric")
        return blur_valid(scene[row : end_row + len(kernel) - 1], kernel)

    def _kernel(self, openings_s: FloatArray) -> FloatArray:
        assert self.motion is not None
        t, xy = extended(self.motion)
        # at its ends the path rests, so that no opening is without a place
        t = np.concatenate([[-_REST], t, [_REST]])
        xy = np.concatenate([xy[:1], xy, xy[-1:]])
        fractions = (openings_s - self.start_s) / self.duration_s
        fractions = fractions[fractions[:, 1] > fractions[:, 0]]
        inside = t[(t > fractions.min()) & (t < fractions.max())]
        points = interpolated(np.concatenate([inside, fractions.ravel()]), t, xy)
        size = max(self._frame_px, 2 * int(np.ceil(np.abs(points).max())) + 3)
        return sum(
            (slice_psfs(t, xy, opening, size)[0] for opening in fractions), np.zeros((size, size))
        )


class TwinCamera(Camera):
    """Camera before an emulated shutter, whose board it brings along.

    Parameters
    ----------
    options : TwinOptions
    uno : EmulatedUno
        Running; owned from now on.

    Attributes
    ----------
    noise : cep.optics.camera.Camera
        Noise model, for the restoration as well.
    clean : (H, W) or (H, W, 3) float ndarray
        Light of the last frame before noise.
    wired : bool
        Whether its output "exposure active" triggers the controller.
    """

    name: ClassVar[str] = "twin"
    summary: ClassVar[str] = (
        "emulated camera, scene and controller, to learn without hardware; needs gcc and simavr"
    )
    triggers: ClassVar[frozenset[Trigger]] = frozenset(Trigger)

    def __init__(self, options: TwinOptions, uno: EmulatedUno) -> None:
        self.options = options
        self.uno = uno
        self.noise = options.noise_model()
        self.scene = MovingScene(light=options.light())
        self.clean = np.zeros(0)
        self.wired = True
        self._settings = CameraSettings(exposure_s=0.01)
        self._armed_cycle: int | None = None
        self._fired_cycle: int | None = None
        self._frames = 0

    @classmethod
    def open(cls, address: str) -> Self:
        """Start the emulated board and put the camera before it."""
        options = TwinOptions.parse(address)
        uno = EmulatedUno(noise_seed=options.seed)
        camera = cls(options, uno)  # before the board runs: its options may be wrong
        try:
            uno.start()
        except EmulationError as error:
            raise ValueError(f"camera: {error}") from None  # what is missing can be installed
        if options.belt_hz:
            uno.trigger(pulses=10**9, hertz=options.belt_hz)
        return camera

    def controller_port(self, port: str | None) -> str:
        """Return the serial port of the emulated controller; another is refused."""
        if port not in (None, "twin"):
            raise ValueError("port: not valid with a twin, which brings its own controller")
        return self.uno.port

    def moves(self, motion: Trajectory, *, start_s: float, duration_s: float) -> None:
        """Let the scene move along a path, from a time after the trigger on, for so long."""
        self.warnings = ()
        self.scene = replace(self.scene, motion=motion, start_s=start_s, duration_s=duration_s)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Take exposure and trigger; the gain is that of the noise model."""
        if not 1e-6 <= settings.exposure_s <= 10:
            raise ValueError(
                f"camera: twin exposes for 1 us to 10 s, got {settings.exposure_s:g} s"
            )
        self._settings = replace(settings, gain_db=0.0)
        if self.scene.motion is None:
            self.scene = replace(self.scene, duration_s=settings.exposure_s)
            self.warnings = ("the twin's scene rests: --linear or --trajectory moves it",)
        return self._settings

    def arm(self) -> None:
        """Expose a frame at the next trigger."""
        self._armed_cycle = self.uno.cycle()

    def wait_ready(self, timeout_s: float) -> None:
        """Return at once: an armed twin is ready."""

    def fire(self) -> None:
        """Begin to expose; the output "exposure active" triggers the controller."""
        self._fired_cycle = self.uno.cycle()
        if self.wired:
            self.uno.trigger()

    def read(self, timeout_s: float) -> Frame:
        """Wait until the board is past the exposure, and integrate over its pins."""
        armed_cycle = self._armed_cycle
        if armed_cycle is None:
            raise FrameLostError("twin: no frame: it was not armed")
        rng = np.random.default_rng([self.options.seed, self._frames])
        late_s = 1e-6 * (self.options.delay_us + self.options.jitter_us * rng.standard_normal())
        trigger_s, start_s, end_s = self._awaited(
            lambda: self._window_s(armed_cycle, late_s), timeout_s
        )
        row_s = 1e-6 * self.options.row_us
        over_s = trigger_s + end_s + row_s * self.scene.rows
        self._awaited(lambda: self.uno.cycle() * _CYCLE_S > over_s or None, over_s + _LATEST_S)
        self._armed_cycle = None
        edges = self.uno.edges()
        self.clean = self.scene.collected(
            openings_s(edges, trigger_s), start_s=start_s, end_s=end_s, row_s=row_s
        )
        noise = self.noise.with_dark_noise(end_s - start_s)
        self._frames += 1
        return Frame(
            values=code_values(noise, noise.expose(self.clean, rng=rng)),
            bits=noise.bits,
            black_level=float(np.rint(noise.black_level * noise.code_steps)),
            frame_id=self._frames,
            timestamp_ns=round((trigger_s + start_s) * 1e9),
            exposure_s=end_s - start_s,
            gain_db=0.0,
            camera="twin",
            serial=str(self.options.seed),
        )

    def close(self) -> None:
        """Switch the board off."""
        self.uno.stop()

    def _window_s(self, armed_cycle: int, late_s: float) -> tuple[float, float, float] | None:
        """Trigger, and start and end of exposure after it, s; None before the trigger came.

        Software fires at once, and its output triggers the controller; else the controller's busy
        output triggers the camera.
        """
        trigger = self._settings.trigger
        if trigger is Trigger.SOFTWARE and not self.wired:
            fired_cycle = self._fired_cycle
            if fired_cycle is None or fired_cycle < armed_cycle:
                return None
            return fired_cycle * _CYCLE_S, late_s, late_s + self._settings.exposure_s
        pin = "trigger" if trigger is Trigger.SOFTWARE else "busy"
        edges = self.uno.edges(pin)
        rise = next((cycle for cycle, level in edges if level and cycle >= armed_cycle), None)
        if rise is None:
            return None
        start_s = 0.0 if trigger is Trigger.SOFTWARE else late_s
        return rise * _CYCLE_S, start_s, start_s + self._settings.exposure_s

    def _awaited(self, answer: Callable[[], Answer | None], timeout_s: float) -> Answer:
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                if (result := answer()) is not None:
                    return result
            except EmulationError as error:
                raise CameraError(f"twin: {error}") from None
            if time.monotonic() >= deadline:
                raise FrameLostError(f"twin: no frame within {timeout_s:g} s: no trigger came")
            time.sleep(_LOOK_S)


def openings_s(edges: Sequence[tuple[int, int]], trigger_s: float) -> FloatArray:
    """Return the openings of an emulated shutter, (P, 2): open and closed, s after the trigger.

    The edges are clock cycles and levels, as of :meth:`hw.emulation.uno.EmulatedUno.edges`.
    """
    cycles = [cycle for cycle, _level in edges]
    if len(cycles) % 2:
        cycles.append(cycles[-1] + round(_REST / _CYCLE_S))  # still open
    return np.array(cycles, dtype=np.float64).reshape(-1, 2) * _CYCLE_S - trigger_s


def code_values(noise: NoiseModel, light: FloatArray) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Whole code values of light that a noise model recorded, the black level added."""
    pedestal = np.rint(noise.black_level * noise.code_steps)
    codes = np.clip(np.rint(light * noise.code_steps) + pedestal, 0, 2**noise.bits - 1)
    if noise.bits <= 8:
        return np.asarray(codes, dtype=np.uint8)
    return np.asarray(codes, dtype=np.uint16)
