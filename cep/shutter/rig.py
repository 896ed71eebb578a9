"""A camera and a shutter controller, open together: armed, fired, and the frame checked."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from cep.files.formatting import duration
from cep.files.shot_files import ShotRecord
from cep.optics.code import ShutterCode
from cep.shutter.burst import BurstCamera
from cep.shutter.exposure_plan import ExposurePlan, Release, ShotSettings, checked_release
from cep.shutter.frame_light import CLIPPED_SHARE, FrameLight, clipped_share
from cep.shutter.play import HEARTBEAT_S, LEASE_MS
from cep.shutter.twin import TwinCamera
from hw.cameras.camera import Camera, CameraSettings, Frame, FrameLostError, Trigger
from hw.cxp.protocol import State, Status
from hw.drivers.cxp import Controller
from motdiff.types import FloatArray

_READY_S = 2.0
_READOUT_S = 3.0  # from the end of exposure until the frame is here
_SETTLE_S = 0.1  # beyond the exposure, within which a second frame would come


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A photo through a code.

    Attributes
    ----------
    record : ShotRecord
        What its restoration needs, and whether it counts.
    """

    frame: Frame
    record: ShotRecord
    warnings: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether the photo was taken through the whole code, once."""
        return self.record.counts

    @property
    def light(self) -> FloatArray:
        """Linear light of the photo, 1 at white."""
        return self.record.light(self.frame.values)

    @property
    def verdict(self) -> str:
        """Whether it counts, and why: the size, the plays, the exposure that held them."""
        if not self.counts:
            return f"does not count: {'; '.join(self.record.problems)}"
        rows, columns = self.frame.values.shape[:2]
        code = self.record.code
        words = (
            f"counts: {columns} x {rows} px of {self.frame.bits} bits;"
            f" {code.chips} chips of {duration(code.chip_ns * 1e-9)}"
        )
        if self.record.details.get("plays") is None:
            return f"{words} summed from frames"
        exposure = "an exposure that the camera does not state"
        if self.frame.exposure_s is not None:
            exposure = f"an exposure of {duration(self.frame.exposure_s)}"
        return f"{words}, played once, no edge missed, within {exposure}"


@dataclass(frozen=True, kw_only=True)
class _Prepared:
    """What the next photos are taken with; no plan where the frames are the shutter."""

    settings: ShotSettings
    record: ShotRecord
    exposure_s: float
    plan: ExposurePlan | None = None

    @property
    def play_s(self) -> float:
        """Shortest exposure that holds the code."""
        return 0.0 if self.plan is None else self.plan.play_s


class Rig:
    """An open camera and, but for a virtual shutter, an open controller.

    Parameters
    ----------
    controller : Controller or None
        None where the camera needs none.
    """

    def __init__(self, camera: Camera, controller: Controller | None) -> None:
        self.camera = camera
        self.controller = controller
        self._prepared: _Prepared | None = None
        self._frame_id: int | None = None

    def prepare(self, code: ShutterCode, settings: ShotSettings | None = None) -> ShotRecord:
        """Set the camera, load the code and read it back; nothing is armed.

        ValueError if the controller cannot play the code, or the camera cannot expose so long, or
        not by such a trigger.
        """
        settings = settings or ShotSettings()
        if self.controller is None:
            self._prepared = self._virtual(code, settings)
        else:
            self._prepared = self._loaded(self.controller, code, settings)
        return self._prepared.record

    def _virtual(self, code: ShutterCode, settings: ShotSettings) -> _Prepared:
        self.camera.controller_port(None)  # refused where the camera needs a controller
        assert isinstance(self.camera, BurstCamera)
        settings.closed_s()  # refused, although nothing waits for it
        played = self.camera.plays(code)
        exposure_s = played.duration_ns * 1e-9
        self.camera.configure(CameraSettings(exposure_s=exposure_s))
        record = ShotRecord(code=played, bits=16, trajectory=settings.motion)
        return _Prepared(settings=settings, record=record, exposure_s=exposure_s)

    def _loaded(
        self, controller: Controller, code: ShutterCode, settings: ShotSettings
    ) -> _Prepared:
        camera = self.camera
        board = controller.announced
        release = checked_release(camera.triggers, camera.name, board.firmware, settings.release)
        plan = ExposurePlan.of(code, settings, release, board_lead_ns=board.lead_ns)
        trigger = Trigger.SOFTWARE if release.fires else Trigger.LINE
        noise = settings.profile
        if noise is not None and not (noise.gain_e_per_dn or noise.full_well_e):
            noise = None  # it has times alone
        if isinstance(camera, TwinCamera):
            noise = camera.noise
            camera.wired = release is not Release.HOST
            if settings.motion is not None:
                code_s = code.duration_ns * 1e-9
                camera.moves(settings.motion, start_s=plan.play_s - code_s, duration_s=code_s)
        real = camera.configure(
            CameraSettings(
                exposure_s=settings.exposure_s or plan.least_exposure_s,
                trigger=trigger,
                gain_db=settings.gain_db,
            )
        )
        plan.check(real.exposure_s)
        report = controller.upload(plan.program)
        record = ShotRecord(
            code=code,
            bits=16,
            trajectory=settings.motion,
            noise=noise,
            details={
                "trigger": str(release),
                "lead_in_ns": plan.lead_ns,
                "firmware": report.firmware,
            },
        )
        return _Prepared(settings=settings, record=record, exposure_s=real.exposure_s, plan=plan)

    def shoot(self) -> Shot:
        """Take a photo through the code that is prepared.

        Raises
        ------
        CameraError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
            If camera or controller fail. The shutter is closed.
        """
        prepared = self._prepared
        if prepared is None:
            raise ValueError("rig: nothing is prepared")
        wait_s = prepared.settings.wait_s
        plan = prepared.plan
        if self.controller is None or plan is None:
            self.camera.arm()
            self.camera.wait_ready(_READY_S)  # a trigger that comes earlier is lost
            self.camera.fire()
            return self._checked(prepared, self.camera.read(wait_s), plays=None, missed=None)
        # the shutter closes at once when anything fails, before the camera is waited for
        with self.controller.link.aborted_on_error():
            before = self.controller.status()
            # the camera first: the shutter must not play before it can expose
            self.camera.arm()
            self.camera.wait_ready(_READY_S)
            self.controller.arm(lease_ms=LEASE_MS)
            if plan.release.fires:
                self.camera.fire()
                time.sleep(plan.wait_s)
            if plan.release in (Release.SHUTTER, Release.HOST):
                self.controller.trigger()
            trigger_s = wait_s if plan.release is Release.EXTERNAL else 2.0
            after = _played(self.controller, before, plan, trigger_s)
            own_photo = Trigger.SOFTWARE in self.camera.triggers
            frame = self.camera.read(prepared.exposure_s + (_READOUT_S if own_photo else wait_s))
        return self._checked(
            prepared,
            frame,
            plays=(after.runs - before.runs) % 65536,  # counted in 16 bits
            missed=after.late - before.late,
        )

    def series(self, count: int, *, keep: Callable[[Shot], object]) -> list[Shot]:
        """Take photos one after the other; one that does not count is the last.

        ``keep`` is called with each photo as soon as it is there; once more with the last, if it
        turns out not to count.
        """
        shots: list[Shot] = []
        try:
            while len(shots) < count and not self._doubled(shots, 0.0):
                shot = self.shoot()
                keep(shot)
                shots.append(shot)
                if not shots[-1].counts:
                    return shots
            # the camera's further frames come after the exposure
            assert self._prepared is not None
            settled_s = self._prepared.exposure_s + _SETTLE_S
            if shots[-1].counts and not self._doubled(shots, settled_s):
                return shots
        except BaseException as error:
            if count > 1:
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

    def _doubts(self, prepared: _Prepared) -> tuple[str, ...]:
        """Say what of the set-up is not checked by itself."""
        if prepared.plan is None:
            return self.camera.warnings
        release = prepared.plan.release
        doubts = []
        if release is Release.HOST:
            doubts.append("no wire times the code: that the exposure held it is trusted")
        elif release is not Release.CAMERA and not prepared.settings.measured_s:
            doubts.append(
                "that the camera begins to expose within the lead-in is trusted, and lost chips"
                " would not show: cep hw timing measures its delay, for --profile"
            )
        return (*doubts, *self.camera.warnings)

    def _checked(
        self, prepared: _Prepared, frame: Frame, *, plays: int | None, missed: int | None
    ) -> Shot:
        """Say whether a frame counts."""
        problems = []
        if plays not in (None, 1):
            problems.append(f"the code was played {plays} times during the exposure")
        if missed:
            problems.append(f"the controller missed {missed} edges")
        if self._frame_id is not None and (step := frame.frame_id - self._frame_id) != 1:
            problems.append(f"the camera counts {step} frames since the last one: one was wanted")
        self._frame_id = frame.frame_id
        if frame.exposure_s is not None and frame.exposure_s < prepared.play_s:
            problems.append(
                f"the camera exposed for {1e3 * frame.exposure_s:.6g} ms, the code needs"
                f" {1e3 * prepared.play_s:.6g} ms"
            )
        record = replace(
            prepared.record,
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
                **prepared.record.details,
            },
        )
        if (noise := record.noise) is not None:  # its light 1 is then the white of the photo
            steps = 2**record.bits - 1 - record.black_level
            noise = noise.at(noise.photons_full_scale * steps / noise.code_steps)
            record = replace(record, noise=noise)
        warnings = (*self._doubts(prepared), *_warnings(frame))
        return Shot(frame=frame, record=record, warnings=warnings)


def _played(controller: Controller, before: Status, plan: ExposurePlan, wait_s: float) -> Status:
    """Wait until the code was played, and keep the lease alive until it begins."""
    deadline = time.monotonic() + wait_s
    beat = time.monotonic() + HEARTBEAT_S
    while (status := controller.status()).state is State.ARMED:
        if time.monotonic() >= deadline:
            raise FrameLostError(f"no trigger came within {wait_s:g} s: nothing was taken")
        if time.monotonic() >= beat:
            controller.renew(lease_ms=LEASE_MS)
            beat = time.monotonic() + HEARTBEAT_S
        time.sleep(0.002)
    if status.state is State.PLAY:
        status = controller.wait(timeout_s=1.1 * plan.play_s + 2)
    if status.state is not State.DONE or status.runs == before.runs:
        raise FrameLostError(
            f"the code was not played: the controller is {status.state.name.lower()}"
        )
    return status


def _warnings(frame: Frame) -> tuple[str, ...]:
    warnings = []
    if clipped_share(frame) > CLIPPED_SHARE:
        warnings.append(FrameLight.of(frame).advice)
    if frame.exposure_s is None:
        warnings.append("the camera does not state its exposure: that it held the code is trusted")
    return tuple(warnings)
