"""Requests to the player of a CXP1 controller, each confirmed by the controller's status
afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from hw.cxp.framing import FrameError
from hw.cxp.link import Link
from hw.cxp.protocol import AT_REST, Hello, Op, State, Status, pack_arm, unpack_crc, unpack_status
from hw.cxp.stored import Stored, stored_program, unpack_stored
from hw.errors import DeviceError
from hw.program import Program


class VerifyError(RuntimeError):
    """The device holds another program, or is in another state, than requested."""


class RemotePlayer:
    """The player on the other side of an open link.

    Parameters
    ----------
    link : Link
        Open link.
    hello : Hello
        HELLO of the device.
    """

    def __init__(self, link: Link, hello: Hello) -> None:
        self.link = link
        self.announced = hello

    def load(self, program: Program, *, clock_ppm: float = 0.0) -> Stored:
        """Store a program in the device, which must be neither armed nor playing; its limits are
        not checked here.

        Returns
        -------
        Stored
            The program sent, whose CRC-32 the device has confirmed.

        Raises
        ------
        ValueError
            If the program cannot be expressed in the device's ticks, see
            `hw.cxp.protocol.stored_program`.
        VerifyError
            If the device confirms something else, or is not loaded afterwards.
        """
        wanted = stored_program(program, self.announced, clock_ppm=clock_ppm)
        try:
            crc = unpack_crc(self.link.request(Op.LOAD, wanted.payload))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None
        if crc != wanted.crc32:
            raise VerifyError(
                f"{self.link.name} confirms CRC32 0x{crc:08x}: 0x{wanted.crc32:08x} was sent"
            )
        status = self.status()
        if status.state is not State.LOADED:
            raise self._belied(Op.LOAD, status)
        return wanted

    def read(self) -> Stored:
        """Read the stored program back, as the device has it.

        Raises
        ------
        VerifyError
            If the reply is no program.
        """
        try:
            return unpack_stored(self.link.request(Op.READ))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None

    def verify(self, program: Program, *, clock_ppm: float = 0.0) -> None:
        """Read the stored program back and compare it.

        Raises
        ------
        VerifyError
            If the device holds another program; the message says what differs.
        """
        wanted = stored_program(program, self.announced, clock_ppm=clock_ppm)
        stored = self.read()
        if stored != wanted:
            raise VerifyError(
                f"{self.link.name} holds another program than it was sent:"
                f" {wanted.difference(stored)}"
            )

    def arm(self, *, lease_ms: int = 10_000) -> Status:
        """Let the next trigger play the program; without one the device disarms itself after
        `lease_ms`.

        Returns
        -------
        Status
            Read back afterwards. The state is ARMED, or PLAY or DONE where the trigger input was
            quicker.

        Raises
        ------
        VerifyError
            If the device is in another state; ABORT has then been sent.
        """
        payload = pack_arm(lease_ms)
        before = self.status()
        with self._closed_on_doubt():
            return self._armed(payload, before)

    def trigger(self) -> None:
        """Play the program once; a lost reply never plays it twice. The device acknowledges, and
        no more is known.
        """
        with self._closed_on_doubt():
            self.link.request(Op.TRIG)

    def play(self, *, timeout_s: float) -> Status:
        """Play the program once, wait for its end, and read back that it was played.

        Returns
        -------
        Status
            Read back afterwards. The state is DONE, one more play has ended, and no edge of it was
            missed.

        Raises
        ------
        VerifyError
            If it still plays after `timeout_s`, or the status is another one; ABORT has then been
            sent.
        """
        before = self.status()
        self.trigger()
        status = self.wait(timeout_s=timeout_s)
        with self._closed_on_doubt():
            ended = (status.runs - before.runs) % 65536
            missed = status.late - before.late
            if (status.state, ended, missed) != (State.DONE, 1, 0):
                raise self._belied(
                    Op.TRIG, status, f", with {ended} plays ended and {missed} edges missed"
                )
        return status

    def abort(self) -> Status:
        """Close the shutter and disarm.

        Returns
        -------
        Status
            Read back afterwards. The state is IDLE or LOADED.

        Raises
        ------
        LinkError
            If the device does not answer.
        VerifyError
            If the device is in another state.
        """
        try:
            self.link.request(Op.ABORT)
            status = self.status()
            if status.state not in AT_REST:
                raise self._belied(Op.ABORT, status)
        except BaseException as error:
            error.add_note("the shutter may still be open")
            raise
        return status

    def status(self) -> Status:
        """Ask for the state of the player.

        Raises
        ------
        VerifyError
            If the reply cannot be understood.
        """
        try:
            return unpack_status(self.link.request(Op.STATUS))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None

    def wait(self, *, timeout_s: float) -> Status:
        """Wait until the device is no longer playing, and return its status.

        Raises
        ------
        VerifyError
            If it still plays after `timeout_s`, or reports a fault; ABORT has then been sent.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            status = self.status()
            late = status.state is State.PLAY and time.monotonic() >= deadline
            if late or status.state is State.FAULT:
                what = f"still plays after {timeout_s:g} s" if late else "reports a fault"
                error = VerifyError(f"{self.link.name} {what}; ABORT was sent")
                self.link.abort_after(error)
                raise error
            if status.state is not State.PLAY:
                return status
            time.sleep(0.001)

    def _armed(self, payload: bytes, before: Status) -> Status:
        self.link.request(Op.ARM, payload)
        status = self.status()
        played = status.state is State.DONE and status.runs != before.runs
        triggered = self.announced.trigger_input and (status.state is State.PLAY or played)
        if status.state is not State.ARMED and not triggered:
            lease_ms = int.from_bytes(payload, "little")
            over = (
                f"; its lease of {lease_ms} ms may be over" if status.state is State.LOADED else ""
            )
            raise self._belied(Op.ARM, status, over)
        return status

    def _belied(self, op: Op, status: Status, more: str = "") -> VerifyError:
        return VerifyError(
            f"{self.link.name} acknowledged {op.name}, but is {status.state.name} afterwards{more}"
        )

    @contextmanager
    def _closed_on_doubt(self) -> Iterator[None]:
        try:
            yield
        except DeviceError:
            raise  # refused: nothing changed in the device
        except BaseException as error:
            # No reply, or a wrong one: it may or may not be armed or open, and closed is the only
            # safe guess.
            self.link.abort_after(error)
            raise
