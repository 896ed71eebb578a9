"""Timing of 20 simulated cameras: errors and intervals of start, length, jitter and row time.

Delays of 0.02 to 20 ms, exposures of 0.5 to 10 ms that the camera states 0 to 40 us wrong, jitter
of 0.05 to 4 us, and global shutters as well as rolling ones of 4 to 30 us a row, behind the
shipped Uno firmware's flashes of 50 us. The light differs by 0.3 % from flash to flash
(docs/hardware.md).

    python -m lab.studies.camera_timing
    python -m lab.studies.camera_timing --twin   # over the emulated board, which states its length
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from cep.shutter.exposure_fit import ExposureTiming
from cep.shutter.exposure_sweep import Exposed, ExposureSweep, Flash, flash_program
from cep.shutter.timing import time_camera
from hw.cxp.protocol import Hello, ResetCause
from lab.studies.inputs import study_parser

UNO = Hello(
    version=1,
    fractions=True,
    trigger_input=True,
    max_chips=1024,
    tick_ns=500,
    min_ticks=100,
    max_ticks=65535,
    max_on_ticks=None,
    max_duty=None,
    lead_ns=17_250,
    reset_cause=ResetCause.POWER,
    firmware="cxp-avr 1",
)


@dataclass
class SimulatedCamera:
    """A 12-bit camera of 480 rows before an uneven light, its exposure integrated exactly."""

    start_s: float
    length_s: float
    jitter_s: float
    row_s: float
    rng: np.random.Generator
    energy_sigma: float = 0.003
    rows: int = 480
    columns: int = 640
    electrons: float = 4000.0  # of a pixel, by a flash of 50 us
    clock: float = 1.0  # of the controller: so much longer are its times
    frames: int = 0

    def __call__(self, flash: Flash) -> Exposed:
        """Take a frame."""
        self.frames += 1
        program = flash_program(flash, UNO)
        times_s = (np.array([edge for edge, _ in program.edges]) + UNO.lead_ns) * 1e-9
        nominal_s = times_s.reshape(-1, 2)
        pulses_s = nominal_s * self.clock
        row = np.arange(self.rows)
        start_s = self.start_s + self.row_s * row + self.jitter_s * self.rng.standard_normal()
        overlap_s = np.clip(
            np.minimum(pulses_s[:, 1], (start_s + self.length_s)[:, None])
            - np.maximum(pulses_s[:, 0], start_s[:, None]),
            0,
            None,
        ).sum(axis=1)
        energy = 1 + self.energy_sigma * self.rng.standard_normal()
        light = 0.7 + 0.3 * np.cos(3 * row / self.rows)
        electrons = self.electrons * light * overlap_s / 50e-6 * energy
        gain = 4.0
        well = 4095 * gain
        pixels = self.rng.poisson(
            np.minimum(electrons, 2 * well)[:, None], (self.rows, self.columns)
        )
        noisy = pixels / gain + 64 + 1.5 * self.rng.standard_normal(pixels.shape)
        values = np.clip(np.rint(noisy), 0, 4095)
        return Exposed(nominal_s, values.mean(axis=1), (values >= 4095).mean(axis=1) > 1e-3)


def random_camera(seed: int) -> tuple[SimulatedCamera, float]:
    """Return a camera, and the exposure that it states."""
    rng = np.random.default_rng(seed)
    stated_s = float(np.exp(rng.uniform(np.log(0.5e-3), np.log(10e-3))))
    return SimulatedCamera(
        start_s=float(np.exp(rng.uniform(np.log(20e-6), np.log(20e-3)))),
        length_s=stated_s + float(rng.uniform(0, 40e-6)),
        jitter_s=float(np.exp(rng.uniform(np.log(0.05e-6), np.log(4e-6)))),
        row_s=0.0 if seed % 2 else float(np.exp(rng.uniform(np.log(4e-6), np.log(30e-6)))),
        clock=1 + 30e-6 * float(rng.standard_normal()),
        rng=rng,
    ), stated_s


def simulated(camera: SimulatedCamera, stated_s: float) -> ExposureTiming:
    sweep = ExposureSweep(camera, length_s=stated_s, flash_s=50e-6, earliest_s=17.25e-6)
    return sweep.run()[0]


def on_twin(camera: SimulatedCamera, seed: int) -> ExposureTiming:
    figures = {"delay": camera.start_s, "jitter": camera.jitter_s, "row": camera.row_s}
    address = ",".join(f"{name}_us={1e6 * value!r}" for name, value in figures.items())
    timed = time_camera(f"twin:{address},seed={seed}", exposure_s=camera.length_s)
    camera.frames = timed.frames
    return timed.timing


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--cameras", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--twin", action="store_true")
    arguments = parser.parse_args()
    print("seed  start_us  err   length_us  err   jitter_us  est   row_us   err_%   frames  s  in")
    covered = np.zeros(4, dtype=int)
    for seed in range(arguments.first, arguments.first + arguments.cameras):
        camera, stated_s = random_camera(seed)
        begin = time.perf_counter()
        timing = on_twin(camera, seed) if arguments.twin else simulated(camera, stated_s)
        truths = (camera.start_s, camera.length_s, camera.jitter_s, camera.row_s)
        estimates = (timing.start, timing.length, timing.jitter, timing.row)
        inside = [truth in estimate for truth, estimate in zip(truths, estimates, strict=True)]
        covered += inside
        row_error = timing.row.value - camera.row_s
        print(
            f"{seed:4d} {1e6 * camera.start_s:9.2f}"
            f" {1e6 * (timing.start.value - camera.start_s):6.2f}"
            f" {1e6 * camera.length_s:9.2f} {1e6 * (timing.length.value - camera.length_s):6.2f}"
            f" {1e6 * camera.jitter_s:8.2f} {1e6 * timing.jitter.value:6.2f}"
            f" {1e6 * camera.row_s:8.3f} {100 * row_error / (camera.row_s or 1e-6):8.4f}"
            f" {camera.frames:5d} {time.perf_counter() - begin:6.1f}"
            f" {''.join('.x'[not covers] for covers in inside)}"
            f"  +-{1e6 * (timing.start.upper - timing.start.value):.2f}"
            f" +-{1e6 * (timing.length.upper - timing.length.value):.2f}"
        )
    print(
        f"covered: start {covered[0]}, length {covered[1]}, jitter {covered[2]}, row {covered[3]}"
    )


if __name__ == "__main__":
    main()
