"""The AVR firmware on the emulated Uno: time to load and verify, latency of the trigger input,
error of the edges.

    python -m lab.studies.hardware [--loads 200] [--triggers 400] [--codes 60]

The Uno runs in real time for the first, since the line of 115200 baud is what takes it; the others
count its cycles.
"""

from __future__ import annotations

import random
import statistics
import time

from cep.codes.published import published
from hw.cxp.protocol import State
from hw.drivers.cxp import Controller
from hw.emulation.uno import CLOCK_HZ, EmulatedUno, EmulationError, build_board
from hw.program import Program
from lab.studies.inputs import study_parser

RASKAR = published("raskar-52").code.bits
CYCLE_NS = 1e9 / CLOCK_HZ
_PATIENCE_S = 30.0  # for a chip of 50 us: the emulation is slow


def load_times_s(loads: int) -> list[float]:
    program = Program(RASKAR, chip_ns=200_000)
    times = []
    with EmulatedUno() as uno, Controller.open(uno.port) as controller:
        for _ in range(loads):
            started = time.perf_counter()
            controller.load(program)
            controller.verify(program)
            times.append(time.perf_counter() - started)
    return sorted(times)


def trigger_latencies(triggers: int) -> list[int]:
    """Clock cycles from an edge on D2 to the opening of the first chip."""
    program = Program("1", chip_ns=50_000)
    with EmulatedUno(speed=0, noise_seed=1) as uno, Controller.open(uno.port) as controller:
        controller.load(program)
        for _ in range(triggers):
            controller.arm(lease_ms=65_535)
            uno.trigger()
            deadline_s = time.monotonic() + _PATIENCE_S
            while controller.status().state is not State.DONE:
                if time.monotonic() > deadline_s:
                    raise SystemExit(f"error: a trigger was not obeyed within {_PATIENCE_S:g} s")
        openings = [cycle for cycle, level in uno.edges() if level]
        trigger_cycles = [cycle for cycle, level in uno.edges("trigger") if level]
    return sorted(after - before for before, after in zip(trigger_cycles, openings, strict=True))


def edge_errors(codes: int) -> tuple[list[int], int]:
    """Errors of all edges against the first of their code, clock cycles, and the number of chips
    played.
    """
    rng = random.Random(1)
    errors = []
    chips = 0
    with EmulatedUno(speed=0) as uno, Controller.open(uno.port) as controller:
        for _ in range(codes):
            bits = "1" + "".join(rng.choice("01") for _ in range(rng.randint(15, 511)))
            program = Program(bits, chip_ns=500 * round(100 * 20 ** rng.random()))
            before = len(uno.edges())
            controller.upload(program, arm=True)
            controller.trigger()
            controller.wait(timeout_s=60)
            edges = uno.edges()[before:]
            errors += [
                round(cycle - edges[0][0] - at_ns / CYCLE_NS)
                for (cycle, _), (at_ns, _) in zip(edges, program.edges, strict=True)
            ]
            chips += program.chips
    return errors, chips


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--loads", type=int, default=200)
    parser.add_argument("--triggers", type=int, default=400)
    parser.add_argument("--codes", type=int, default=60)
    options = parser.parse_args()
    try:
        build_board()
    except EmulationError as error:
        print(f"left out: {error}")
        return
    times = load_times_s(options.loads)
    print(
        f"load and verify, 52 chips: median {statistics.median(times) * 1e3:.1f} ms, worst"
        f" {times[-1] * 1e3:.1f} ms"
    )
    cycles = trigger_latencies(options.triggers)
    lines = [
        f"{name} {at * CYCLE_NS / 1e3:.2f} us"
        for name, at in (
            ("median", statistics.median(cycles)),
            ("least", cycles[0]),
            ("most", cycles[-1]),
        )
    ]
    print(f"trigger input to first chip, {len(cycles)} triggers: {', '.join(lines)}")
    errors, chips = edge_errors(options.codes)
    print(
        f"edges: {len(errors)} of {chips} chips are {min(errors):+d}..{max(errors):+d} cycles of"
        " 62.5 ns off"
    )


if __name__ == "__main__":
    main()
