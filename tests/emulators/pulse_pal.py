"""A Pulse Pal v2 on a pseudo-terminal, written from its protocol alone (nothing of `hw` is
imported).

It keeps what the real one keeps: two train memories that are never cleared, parameters per
channel, links from the trigger inputs. What a channel puts out is computed as edges in 50 us
cycles; cycles go by with the wall clock, but at least one per command, as in the firmware that
serves one command per cycle.
"""

from __future__ import annotations

import os
import select
import struct
import threading
import time
import tty
from dataclasses import dataclass, field

CYCLE_S = 50e-6
CELLS = 5001  # per train; the firmware writes behind them when told to
REST = 32768  # DAC codes of 0 V and 5 V
OPEN_5V = 49152
FOREVER = 2**32  # a time that comes again only when the counter wraps, after 59 hours
HELLO = 72
PARAM = 74
TRAIN_1 = 75
TRAIN_2 = 76
SOFT_TRIGGER = 77
FIXED = 79
ABORT = 80
DISCONNECT = 81
INFO = 94
WIDTHS = {
    1: 1,
    2: 2,
    3: 2,
    **dict.fromkeys(range(4, 12), 4),
    **dict.fromkeys(range(12, 17), 1),
    17: 2,
    128: 1,
}
DEFAULTS = {1: 0, 2: OPEN_5V, 3: 16384, 4: 20, 5: 20, 6: 20, 7: 200, 8: 0, 9: 0, 10: 20_000, 11: 0}
DEFAULTS |= {12: 1, 13: 0, 14: 0, 15: 0, 16: 0, 17: REST}


@dataclass(frozen=True)
class Faults:
    """What goes wrong; nothing by default."""

    silent: bool = False
    babble: bytes = b""  # sent instead of any reply
    boot_noise: bytes = b""
    deaf_s: float = 0.0  # bytes that come earlier after the first one vanish
    late_s: dict[int, float] = field(default_factory=dict)  # op -> how much longer it takes
    # op after which (done, unanswered) nothing is ever answered again
    silent_after: int | None = None
    unplug_on: int | None = None  # op whose bytes pull the cable
    refuse: int | None = None  # parameter that is answered by 0
    twice: int | None = None  # op that is answered twice


@dataclass
class Play:
    """One run of a channel: its edges as (cycle after the trigger, DAC code), and when it ends
    (None: never)."""

    channel: int
    start: int
    edges: list[tuple[int, int]]
    end: int | None
    killed: int | None = None


@dataclass
class Channel:
    """An output: its parameters by number, what it plays, and a soft trigger not yet taken."""

    values: dict[int, int] = field(default_factory=DEFAULTS.copy)
    play: Play | None = None
    pending: int | None = None


class PulsePal:
    """The device; use as a context manager. `port` is the name of its pseudo-terminal."""

    def __init__(
        self, faults: Faults | None = None, *, firmware: int = 21, timer_us: int = 50
    ) -> None:
        self.faults = faults or Faults()
        self.firmware = firmware
        self.timer_us = timer_us
        self.channels = {k: Channel() for k in range(1, 5)}
        self.trigger_modes = {1: 0, 2: 0}
        self.times = {k: [0] * CELLS for k in (TRAIN_1, TRAIN_2)}
        self.volts = {k: [0] * CELLS for k in (TRAIN_1, TRAIN_2)}
        self.counts = {TRAIN_1: 0, TRAIN_2: 0}
        self.ops: list[int] = []
        self._plays: list[Play] = []
        self.client: str | None = None
        self.pending = b""
        self.ignored = b""  # bytes that began no command
        self.first_byte: float | None = None
        self.mute = self.faults.silent
        self.unplugged = False
        self.overrun = False  # a train was written past its memory
        self._cycle = 0
        self._begin = time.monotonic()
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> PulsePal:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=10)
        assert not self._thread.is_alive()

    def plays(self, channel: int = 1) -> list[Play]:
        """Every run of an output begun up to now."""
        with self._lock:
            self._advance()
            return [play for play in self._plays if play.channel == channel]

    def volts_now(self, channel: int) -> int:
        """DAC code on an output at this moment."""
        with self._lock:
            self._advance()
            play = self.channels[channel].play
            code = self.channels[channel].values[17]
            for at, level in play.edges if play else []:
                if play is not None and play.start + at <= self._cycle:
                    code = level
            return code

    def trigger_input(self, number: int) -> None:
        """A rising edge on a trigger input, which starts the idle channels linked to it."""
        with self._lock:
            self._advance()
            for index, channel in self.channels.items():
                if (
                    channel.values[11 + number]
                    and self.trigger_modes[number] == 0
                    and channel.play is None
                ):
                    self._start(index, self._cycle)

    def _run(self) -> None:
        try:
            if self.faults.boot_noise:
                os.write(self.master, self.faults.boot_noise)
            while not self._stop.is_set() and not self.unplugged:
                ready, _, _ = select.select([self.master], [], [], 0.01)
                if ready:
                    self._take(os.read(self.master, 65536))
        finally:
            os.close(self.master)
            os.close(self.slave)

    def _take(self, data: bytes) -> None:
        self.first_byte = self.first_byte or time.monotonic()
        if time.monotonic() - self.first_byte < self.faults.deaf_s:
            return
        if self.faults.babble:
            os.write(self.master, self.faults.babble)
            return
        self.pending += data
        while self.pending and not self.unplugged:
            if self.pending[0] != 213:
                self.ignored = self.ignored + self.pending[:1]
                self.pending = self.pending[1:]
                continue
            if len(self.pending) > 1 and self.pending[1] == self.faults.unplug_on:
                self.unplugged = True
                return
            length = self._length(self.pending)
            if length is None or len(self.pending) < length:
                return
            command = self.pending[:length]
            self.pending = self.pending[length:]
            with self._lock:
                self._cycle += 1  # a command takes a cycle of its own
                self._advance()
                self.ops.append(command[1])
                reply = self._serve(command[1], command[2:])
            self.mute = self.mute or command[1] == self.faults.silent_after
            if not self.mute:
                time.sleep(self.faults.late_s.get(command[1], 0.0))
                os.write(self.master, reply * (2 if command[1] == self.faults.twice else 1))

    @staticmethod
    def _length(data: bytes) -> int | None:
        """Bytes of the command that begins here, or None as long as that is not known."""
        if len(data) < 2:
            return None
        if data[1] == PARAM:
            return 4 + WIDTHS[data[2]] if len(data) > 2 else None
        if data[1] in (TRAIN_1, TRAIN_2):
            return 6 + 6 * int.from_bytes(data[2:6], "little") if len(data) >= 6 else None
        return {SOFT_TRIGGER: 3, FIXED: 5, 89: 8}.get(data[1], 2)

    def _serve(self, op: int, data: bytes) -> bytes:
        if op == HELLO:
            self.client = "connected"
            return b"K" + struct.pack("<I", self.firmware)
        if op == INFO and self.firmware >= 22:
            return struct.pack("<BIBI", 2, self.timer_us, 2, 5000)
        if op == PARAM:
            number = data[0]
            channel = data[1]
            value = int.from_bytes(data[2:], "little")
            if number == self.faults.refuse:
                return b"\0"
            if number == 128:
                self.trigger_modes[channel] = value
            else:
                self.channels[channel].values[number] = value
            return b"\1"
        if op in (TRAIN_1, TRAIN_2):
            count = int.from_bytes(data[:4], "little")
            if count > CELLS - 1:
                # other memory is overwritten: nothing is certain any more
                self.overrun = self.mute = True
                return b""
            self.counts[op] = count
            self.times[op][:count] = struct.unpack_from(f"<{count}I", data, 4)
            self.volts[op][:count] = struct.unpack_from(f"<{count}H", data, 4 + 4 * count)
            return b"\1"
        if op == SOFT_TRIGGER:
            for index, channel in self.channels.items():
                if data[0] >> (index - 1) & 1:
                    channel.pending = self._cycle + 1
        elif op in (ABORT, DISCONNECT):
            for channel in self.channels.values():
                if channel.play is not None:
                    channel.play.killed = self._cycle
                    channel.play.edges = [
                        edge
                        for edge in channel.play.edges
                        if channel.play.start + edge[0] < self._cycle
                    ]
                    channel.play.edges.append(
                        (self._cycle - channel.play.start, channel.values[17])
                    )
                channel.play = None
        return b""

    def _advance(self) -> None:
        """Let the cycles up to now go by: trains end, soft triggers start idle channels."""
        self._cycle = max(self._cycle, int((time.monotonic() - self._begin) / CYCLE_S))
        for index, channel in self.channels.items():
            while True:
                play = channel.play
                if (
                    play is not None
                    and play.end is not None
                    and play.start + play.end < self._cycle
                ):
                    channel.play = None
                elif (
                    play is None and channel.pending is not None and channel.pending < self._cycle
                ):
                    # Taken in its own cycle or as soon as the channel is idle; a command of that
                    # cycle came before.
                    last = [old for old in self._plays if old.channel == index][-1:]
                    free = [(old.killed or old.start + (old.end or 0)) for old in last]
                    start, channel.pending = max([channel.pending, *free]), None
                    self._start(index, start)
                else:
                    break

    def _start(self, index: int, cycle: int) -> None:
        channel = self.channels[index]
        edges, end = self.output(channel.values)
        channel.play = Play(index, cycle, edges, end)
        self._plays.append(channel.play)

    def output(self, values: dict[int, int]) -> tuple[list[tuple[int, int]], int | None]:
        """What a channel with these parameters puts out after a trigger; only what a code needs is
        modelled."""
        if values[1] or values[15] or values[8] or values[16]:
            raise NotImplementedError("biphasic pulses, bursts and loops")
        delay = values[11]
        width = values[4]
        rest = values[17]
        if (
            values[14] == 0
        ):  # pulses of one voltage with equal gaps, till the train's duration is over
            starts = range(delay, delay + values[10], width + values[7])
            edges = [
                edge for start in starts for edge in ((start, values[2]), (start + width, rest))
            ]
            return edges, delay + values[10]
        op = TRAIN_1 if values[14] == 1 else TRAIN_2
        times = self.times[op]
        volts = self.volts[op]
        count = self.counts[op]
        edges = []
        now = times[0]
        for k in range(count):
            edges.append((delay + now, volts[k]))
            # The next entry is looked at even behind the last pulse, where an older train may have
            # left something.
            following = times[k + 1]
            if (following - times[k]) % 2**32 > width:
                edges.append((delay + now + width, rest))
                ready = now + width
                joined = False
            else:
                ready = now
                joined = True
            if k == count - 1:
                if not joined:
                    return edges, delay + ready
                if (
                    following > now
                ):  # one more entry is played, and the channel is stopped in the same cycle
                    edges.append((delay + following, rest))
                    return edges, delay + following
                return edges, None
            if following < ready or (joined and following == now):
                return (
                    edges,
                    None,
                )  # its cycle has gone by: the channel waits for the counter to wrap
            now = following
        return edges, 0


def levels(edges: list[tuple[int, int]], *, rest: int) -> list[tuple[int, int]]:
    """Drop edges that change nothing or are overwritten in the same cycle."""
    out: list[tuple[int, int]] = []
    level = rest
    for index, (at, code) in enumerate(edges):
        if index + 1 < len(edges) and edges[index + 1][0] == at:
            continue
        if code != level:
            out.append((at, code))
            level = code
    return out
