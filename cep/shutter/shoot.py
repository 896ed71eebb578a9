"""A camera and a coded shutter that expose together: upload, arm, fire, read the frame, check."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from cep.files.shot_files import ShotRecord
from cep.optics.camera import Camera as NoiseModel
from cep.optics.code import ShutterCode
from cep.shutter.burst import BurstCamera
from cep.shutter.cameras import CAMERAS
from cep.shutter.twin import TwinCamera
from hw.cameras import open_camera
from hw.cameras.camera import (
    Camera,
    CameraSettings,
    Frame,
    FrameLostError,
    Trigger,
)
from hw.cxp.protocol import State, Status
from hw.drivers.cxp import Controller
from hw.program import Program
from motdiff.trajectory import Trajectory

LEASE_MS = 1000
"""An armed controller disarms itself after this without its host, ms."""
HEARTBEAT_S = LEASE_MS / 4000
"""So often the host renews that."""
NO_BUSY_OUTPUT = "cxp-rp2040"
"""Firmware without an output that is high while a code plays."""
LEAD_IN_S = 0.001
"""Closed time before the code: the camera may begin to expose so late, s."""

_MARGIN_S = 0.0005  # of the exposure beyond the code, for the jitter of its start
_HOST_MARGIN_S = 0.05  # where no wire times the code
_CLOCK_SHARE = 0.002  # and for the error of two clocks: ceramic resonators
_READY_S = 2.0
_READOUT_S = 3.0  # from the end of exposure until the frame is here
_SETTLE_S = 0.1  # beyond the exposure, within which a second frame would come
_CLIPPED_SHARE = 0.01  # of the pixels, from which on a warning is due


class Release(StrEnum):
    """Who begins an exposure."""

    SHUTTER = "shutter"
    """This computer plays the code; the controller's output "busy" triggers the camera."""
    CAMERA = "camera"
    """This computer fires the camera; its output "exposure active" triggers the controller."""
    EXTERNAL = "external"
    """The machine triggers the controller, whose output "busy" triggers the camera."""
    HOST = "host"
    """This computer fires the camera, and plays the code a lead-in later, without a wire."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A photo through a code.

    Attributes
    ----------
    frame : Frame
    record : ShotRecord
        What its restoration needs, and whether it counts.
    warnings : tuple of str
    """

    frame: Frame
    record: ShotRecord
    warnings: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether the photo was taken through the whole code, once."""
        return self.record.counts


class Rig:
    """An open camera and, but for a virtual shutter, an open controller.

    Parameters
    ----------
    camera : Camera
    controller : Controller or None
        None where the camera needs none.
    """

    def __init__(self, camera: Camera, controller: Controller | None) -> None:
        self.camera = camera
        self.controller = controller
        self._record: ShotRecord | None = None
        self._release = Release.SHUTTER
        self._least_exposure_s = 0.0
        self._exposure_s = 0.0
        self._play_s = 0.0
        self._wait_s = 0.0
        self._is_timed = False
        self._frame_id: int | None = None

    def prepare(
        self,
        code: ShutterCode,
        *,
        release: Release | None = None,
        motion: Trajectory | None = None,
        profile: NoiseModel | None = None,
        lead_in_s: float | None = None,
        exposure_s: float | None = None,
        gain_db: float | None = None,
    ) -> ShotRecord:
        """Set the camera, load the code and read it back; nothing is armed.

        Parameters
        ----------
        code : ShutterCode
        release : Release, optional
            The camera's own trigger input is preferred when omitted.
        motion : Trajectory, optional
            Of the image during the code.
        profile : cep.optics.camera.Camera, optional
            The camera's figures: its noise, for the restoration, and, where ``cep hw timing`` has
            measured them, its times.
        lead_in_s : float, optional
            Closed time before the code, s, in whole chips: by so much the camera may be late. That
            of the profile when omitted, or :data:`LEAD_IN_S`.
        exposure_s : float, optional
            The least that holds the code when omitted.
        gain_db : float, optional

        Raises
        ------
        ValueError
            If the controller cannot play the code, or the camera cannot expose so long, or not by
            such a trigger. Nothing is armed.
        """
        measured_s = 0.0 if profile is None else profile.lead_in_s
        if lead_in_s is None:
            lead_in_s = measured_s or LEAD_IN_S
        if not (math.isfinite(lead_in_s) and 0 <= lead_in_s <= 1):
            raise ValueError(f"lead_in: must be a time within 0..1 s, got {lead_in_s:g} s")
        if lead_in_s < measured_s:
            raise ValueError(
                f"lead_in: {1e3 * lead_in_s:.6g} ms is less than the camera's delay,"
                f" {1e3 * measured_s:.6g} ms by its profile"
            )
        self._is_timed = measured_s > 0
        if self.controller is None:
            return self._prepare_virtual(code, motion)
        self._release = checked_release(
            self.camera.triggers,
            self.camera.name,
            self.controller.announced.firmware,
            release,
        )
        self._wait_s = lead_in_s if self._release is Release.HOST else 0.0
        closed_chips = math.ceil((lead_in_s - self._wait_s) * 1e9 / code.chip_ns - 1e-9)
        program = Program.from_bits("0" * closed_chips + code.bits, chip_ns=code.chip_ns)
        lead_ns = self.controller.announced.lead_ns + closed_chips * code.chip_ns
        # late by the lead-in at most, the exposure still holds the code's first chip and last
        self._play_s = self._wait_s + 1e-9 * (lead_ns + code.duration_ns)
        margin_s = _HOST_MARGIN_S if self._release is Release.HOST else _MARGIN_S
        self._least_exposure_s = self._play_s * (1 + _CLOCK_SHARE) + margin_s
        if profile is not None:
            self._least_exposure_s = max(
                self._least_exposure_s, profile.least_stated_s(self._play_s)
            )
        asked_s = exposure_s or self._least_exposure_s
        trigger = Trigger.SOFTWARE
        if self._release in (Release.SHUTTER, Release.EXTERNAL):
            trigger = Trigger.LINE if Trigger.LINE in self.camera.triggers else Trigger.WIDTH
        if isinstance(self.camera, TwinCamera):
            self.camera.wired = self._release is not Release.HOST
            if motion is not None:
                code_s = code.duration_ns * 1e-9
                self.camera.moves(motion, start_s=self._play_s - code_s, duration_s=code_s)
        settings = self.camera.configure(
            CameraSettings(exposure_s=asked_s, trigger=trigger, gain_db=gain_db)
        )
        self._exposure_s = settings.exposure_s
        self._check_exposure(settings.exposure_s)
        report = self.controller.upload(program)
        self._record = ShotRecord(
            code=code,
            bits=16,
            trajectory=motion,
            noise=self.camera.noise if isinstance(self.camera, TwinCamera) else _noise(profile),
            details={
                "trigger": str(self._release),
                "lead_in_ns": lead_ns,
                "firmware": report.firmware,
            },
        )
        return self._record

    def shoot(self, *, wait_s: float = 10.0) -> Shot:
        """Take a photo through the code that is prepared.

        Parameters
        ----------
        wait_s : float
            For the machine's own trigger, or another program's photo.

        Raises
        ------
        CameraError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
            If camera or controller fail. The shutter is closed.
        """
        if self._record is None:
            raise ValueError("rig: nothing is prepared")
        if self.controller is None:
            self.camera.arm()
            self.camera.fire()
            return self._checked(self.camera.read(wait_s), plays=None, missed=None)
        with _closed_on_failure(self.controller):
            before = self.controller.status()
            self.camera.arm()
            self.camera.wait_ready(_READY_S)
            self.controller.arm(lease_ms=LEASE_MS)
            if self._release in (Release.CAMERA, Release.HOST):
                self.camera.fire()
                time.sleep(self._wait_s)
            if self._release in (Release.SHUTTER, Release.HOST):
                self.controller.trigger()
            after = self._played(before, wait_s if self._release is Release.EXTERNAL else 2.0)
            own_photo = Trigger.SOFTWARE in self.camera.triggers
            frame = self.camera.read(self._exposure_s + (_READOUT_S if own_photo else wait_s))
        return self._checked(
            frame, plays=(after.runs - before.runs) % 65536, missed=after.late - before.late
        )

    def series(
        self, count: int, *, wait_s: float = 10.0, keep: Callable[[Shot], object]
    ) -> list[Shot]:
        """Take photos one after the other; one that does not count is the last.

        Parameters
        ----------
        count : int
        wait_s : float
            As of :meth:`shoot`.
        keep : callable
            Called with each photo as soon as it is there; once more with the last, if it turns
            out not to count.
        """
        shots: list[Shot] = []
        try:
            while len(shots) < count and not self._doubled(shots, 0.0):
                shot = self.shoot(wait_s=wait_s)
                keep(shot)
                shots.append(shot)
                if not shots[-1].counts:
                    return shots
            # the camera's further frames come after the exposure
            if shots[-1].counts and not self._doubled(shots, self._exposure_s + _SETTLE_S):
                return shots
        except BaseException as error:
            error.add_note(f"{len(shots)} of {count} photos were taken before, and count")
            raise
        keep(shots[-1])
        return shots

    def _doubled(self, shots: list[Shot], timeout_s: float) -> bool:
        """Whether a second frame came for the last trigger; the photo then does not count."""
        if not shots or self.controller is None:
            return False
        try:
            frame = self.camera.read(timeout_s)
        except FrameLostError:
            return False
        problem = (
            f"a second frame, {frame.frame_id}, came for one trigger: either may hold the code"
        )
        record = shots[-1].record
        shots[-1] = replace(
            shots[-1], record=replace(record, problems=(*record.problems, problem))
        )
        return True

    def _doubts(self) -> tuple[str, ...]:
        """Say what of the set-up is not checked by itself."""
        if isinstance(self.camera, BurstCamera):
            return self.camera.warnings
        doubts = []
        if self._release is Release.HOST:
            doubts.append("no wire times the code: that the exposure held it is trusted")
        elif self._release is not Release.CAMERA and not self._is_timed:
            doubts.append(
                "that the camera begins to expose within the lead-in is trusted, and lost chips"
                " would not show: cep hw timing measures its delay, for --profile"
            )
        if isinstance(self.camera, TwinCamera) and self.camera.scene.motion is None:
            doubts.append("the twin's scene rests: --linear or --trajectory moves it")
        return tuple(doubts)

    def _prepare_virtual(self, code: ShutterCode, motion: Trajectory | None) -> ShotRecord:
        if not isinstance(self.camera, BurstCamera):
            raise ValueError(f"port: camera {self.camera.name}: needs a controller, name its port")
        played = self.camera.plays(code)
        self.camera.configure(CameraSettings(exposure_s=played.duration_ns * 1e-9))
        self._exposure_s = played.duration_ns * 1e-9
        self._record = ShotRecord(code=played, bits=16, trajectory=motion)
        return self._record

    def _check_exposure(self, exposure_s: float) -> None:
        if exposure_s < self._play_s:
            raise ValueError(
                f"exposure: {1e3 * exposure_s:.6g} ms is shorter than the code with its lead-in,"
                f" {1e3 * self._play_s:.6g} ms; set {1e3 * self._least_exposure_s:.6g} ms or more"
            )

    def _played(self, before: Status, wait_s: float) -> Status:
        """Wait until the code was played, and keep the lease alive until it begins."""
        assert self.controller is not None
        deadline = time.monotonic() + wait_s
        beat = time.monotonic() + HEARTBEAT_S
        while (status := self.controller.status()).state is State.ARMED:
            if time.monotonic() >= deadline:
                raise FrameLostError(f"no trigger came within {wait_s:g} s: nothing was taken")
            if time.monotonic() >= beat:
                self.controller.arm(lease_ms=LEASE_MS)
                beat = time.monotonic() + HEARTBEAT_S
            time.sleep(0.002)
        if status.state is State.PLAY:
            status = self.controller.wait(timeout_s=1.1 * self._play_s + 2)
        if status.state is not State.DONE or status.runs == before.runs:
            raise FrameLostError(
                f"the code was not played: the controller is {status.state.name.lower()}"
            )
        return status

    def _checked(self, frame: Frame, *, plays: int | None, missed: int | None) -> Shot:
        """Say whether a frame counts."""
        assert self._record is not None
        problems = []
        if plays not in (None, 1):
            problems.append(f"the code was played {plays} times during the exposure")
        if missed:
            problems.append(f"the controller missed {missed} edges")
        if self._frame_id is not None and (step := frame.frame_id - self._frame_id) != 1:
            problems.append(f"the camera counts {step} frames since the last one: one was wanted")
        self._frame_id = frame.frame_id
        if frame.exposure_s is not None and frame.exposure_s < self._play_s:
            problems.append(
                f"the camera exposed for {1e3 * frame.exposure_s:.6g} ms, the code needs"
                f" {1e3 * self._play_s:.6g} ms"
            )
        record = replace(
            self._record,
            bits=frame.bits,
            black_level=frame.black_level or 0.0,
            bayer=frame.bayer,
            gamma=frame.gamma,
            problems=tuple(problems),
            details={
                "camera": " ".join(dict.fromkeys([self.camera.name, frame.camera])),
                "serial": frame.serial,
                "frame_id": frame.frame_id,
                "timestamp_ns": frame.timestamp_ns,
                "exposure_s": frame.exposure_s,
                "gain_db": frame.gain_db,
                "plays": plays,
                "missed_edges": missed,
                **self._record.details,
            },
        )
        if record.noise is not None:
            record = replace(record, noise=_at_white(record.noise, record))
        return Shot(frame=frame, record=record, warnings=(*self._doubts(), *_warnings(frame)))


def shoot(
    camera: str,
    code: ShutterCode | Sequence[ShutterCode],
    *,
    port: str | None = None,
    count: int = 1,
    release: Release | str | None = None,
    motion: Trajectory | None = None,
    profile: NoiseModel | None = None,
    lead_in_s: float | None = None,
    exposure_s: float | None = None,
    gain_db: float | None = None,
    wait_s: float = 10.0,
    keep: Callable[[Shot], object] = lambda _shot: None,
) -> tuple[Shot, ...]:
    """Take photos through a code: upload, read back, arm, fire, read the frame, check.

    Parameters
    ----------
    camera : str
        As ``pylon:``, ``pylon:22845317`` or ``twin:scene=cat``: a kind of
        :data:`cep.shutter.cameras.CAMERAS`, and which.
    code : ShutterCode, or a sequence
        Of several each is loaded in turn, for ``count`` photos.
    port : str, optional
        Serial port of the controller, or ``auto``; a twin brings its own, a burst needs none.
    count : int
        Photos, one after the other; the first that does not count ends them.
    release, motion, profile, lead_in_s, exposure_s, gain_db
        As of :meth:`Rig.prepare`.
    wait_s : float
        As of :meth:`Rig.shoot`.
    keep : callable
        Called with each photo as soon as it is there.

    Raises
    ------
    ValueError
        If there is no such camera or controller, or they cannot play and hold the code; nothing
        was armed.
    CameraError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
        If camera or controller fail. The shutter is closed, the camera released.

    Examples
    --------
    ::

        (shot,) = shoot("pylon:", cep.load_code("code.json"), port="/dev/ttyACM0")
        print(shot.counts, shot.frame.values.max())
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    codes = [code] if isinstance(code, ShutterCode) else list(code)
    chosen = None if release is None else Release(release)
    shots: list[Shot] = []
    with open_rig(camera, port) as rig:
        for played in codes:
            rig.prepare(
                played,
                release=chosen,
                motion=motion,
                profile=profile,
                lead_in_s=lead_in_s,
                exposure_s=exposure_s,
                gain_db=gain_db,
            )
            shots += rig.series(count, wait_s=wait_s, keep=keep)
            if not shots[-1].counts:
                break
    return tuple(shots)


@contextmanager
def open_rig(camera: str, port: str | None = None) -> Iterator[Rig]:
    """Open a camera and the controller of its shutter; parameters and errors are `shoot`'s."""
    with ExitStack() as stack:
        device = stack.enter_context(open_camera(camera, CAMERAS))
        if isinstance(device, TwinCamera):
            if port not in (None, "twin"):
                raise ValueError("port: not valid with a twin, which brings its own controller")
            port = device.port
        if isinstance(device, BurstCamera):
            if port is not None:
                raise ValueError("port: not valid with a burst, whose frames are its shutter")
            yield Rig(device, None)
            return
        if port is None:
            raise ValueError(f"port: camera {device.name}: needs a controller; name its port")
        yield Rig(device, stack.enter_context(Controller.open(port)))


@contextmanager
def _closed_on_failure(controller: Controller) -> Iterator[None]:
    """Close the shutter at once when anything fails, before the camera is waited for."""
    try:
        yield
    except BaseException as error:
        controller.link.abort_after(error)
        raise


def checked_release(
    triggers: frozenset[Trigger], kind: str, firmware: str, release: Release | None
) -> Release:
    """Return who begins an exposure; a ValueError says what camera or controller lack for it.

    Parameters
    ----------
    triggers : frozenset of Trigger
        Of the camera.
    kind : str
        Of camera.
    firmware : str
        Of the controller.
    release : Release or None
        None for the best that both can.
    """
    fires = Trigger.SOFTWARE in triggers
    has_input = bool(triggers & {Trigger.LINE, Trigger.WIDTH})
    has_busy = not firmware.startswith(NO_BUSY_OUTPUT)
    if release is None:
        return Release.SHUTTER if has_input and (has_busy or not fires) else Release.CAMERA
    if release in (Release.CAMERA, Release.HOST) and not fires:
        raise ValueError(
            f"release: this computer cannot fire a camera {kind}:; shutter and external can"
        )
    if release in (Release.SHUTTER, Release.EXTERNAL):
        if not has_input:
            raise ValueError(
                f"release: camera {kind}: has no trigger input; camera and host fire it"
            )
        if not has_busy and fires:
            raise ValueError(
                f'release: {firmware} has no output "busy" to trigger the camera; camera does'
                " without"
            )
    return release


def _noise(profile: NoiseModel | None) -> NoiseModel | None:
    """Return a profile that has more than times."""
    is_known = profile is not None and (profile.gain_e_per_dn or profile.full_well_e)
    return profile if is_known else None


def _at_white(noise: NoiseModel, record: ShotRecord) -> NoiseModel:
    """Return a noise model whose light 1 is the white of a photo."""
    steps = 2**record.bits - 1 - record.black_level
    return noise.at(noise.photons_full_scale * steps / noise.code_steps)


def _warnings(frame: Frame) -> tuple[str, ...]:
    clipped = float(np.mean(frame.values >= 2**frame.bits - 1))
    warnings = []
    if clipped > _CLIPPED_SHARE:
        warnings.append(f"{clipped:.1%} of the pixels are white: less light or gain")
    if frame.exposure_s is None:
        warnings.append("the camera does not state its exposure: that it held the code is trusted")
    return tuple(warnings)
