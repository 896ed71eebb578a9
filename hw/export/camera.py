"""Recipe for cameras that integrate several exposures into one frame: the sensor is the shutter."""

from __future__ import annotations

import tomllib
from decimal import Decimal
from itertools import pairwise

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, item_rows, microseconds
from hw.program import Program

_FORMAT = "hw.camera/1"
_MOST_PULSES = 4095  # the register's parameter has 12 bits


class CameraRecipe(Exporter):
    """Trigger pulses of a camera, and the settings with which it integrates them."""

    name = "camera"
    suffix = ".camera.toml"
    summary = "recipe for multi-exposure cameras: number, widths and gaps of the trigger pulses"
    needs = "a camera that integrates several exposures into one frame"
    manual = "IIDC 1.32, trigger mode 5 (FLIR); XIMEA xiAPI; Balluff mvMultiExposureCount"

    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write the pulses as widths and gaps, and the settings of three makers.

        A camera that adds ``device.on_bias_ns`` to each exposure by itself gets pulses shorter by
        that; the openings remain where the code has them.

        ValueError if there are more pulses than the cameras count, or an opening is no longer than
        the camera's bias.
        """
        pulses = program.pulses
        bias = device.on_bias_ns
        if pulses > _MOST_PULSES:
            raise ValueError(
                f"code has {pulses} openings: multi-exposure cameras count at most {_MOST_PULSES}"
            )
        times = [time_ns for time_ns, _ in program.edges]
        widths = [end - start - bias for start, end in zip(times[::2], times[1::2], strict=True)]
        if min(widths) <= 0:
            raise ValueError(
                f"shortest opening is {min(widths) + bias} ns: the camera adds {bias} ns to every"
                " pulse by itself, so every opening must be longer"
            )
        # Times alternate between openings and closings: every second difference is a gap.
        gaps = [after - before + bias for before, after in pairwise(times[1:-1])][::2]
        active = "low" if device.closed_level else "high"
        # IIDC counts bits from the highest: presence 0, on 6, polarity 7 (1: active high), mode
        # 12-15, parameter 20-31.
        register = 1 << 31 | 1 << 25 | (1 - device.closed_level) << 24 | 5 << 16 | pulses
        return f"""\
# Multi-exposure recipe written by coded-exposure: {program.chips} chips of {program.chip_ns} ns, all in one frame.
# Apply the pulses to the camera's trigger input; it exposes while the input is {active}. The chips are read out once.
# Every width is {microseconds(bias)} us shorter than its opening, since the camera adds that by itself, and every gap longer.
format = "{_FORMAT}"
code_crc32 = "0x{program.code_crc32:08x}"
chip_ns = {program.chip_ns}
chips = {program.chips}

[pulses]
count = {pulses}
active_level = {1 - device.closed_level}
on_bias_us = {microseconds(bias)}
first_delay_us = {microseconds(times[0])}
widths_us = [{_list(widths)}]
gaps_us = [{_list(gaps)}]  # from the end of a pulse to the start of the next
last_delay_us = {microseconds(program.duration_ns - times[-1])}  # closed chips behind the last opening

[flir]  # FLIR, Point Grey: trigger mode 5, multiple exposure pulse width; set the input pin in bits 8-10
register = "0x830"
value = "0x{register:08x}"

[ximea]  # xiAPI names; set XI_PRM_TRG_SOURCE to the input and its active level
XI_PRM_TRG_SELECTOR = "XI_TRG_SEL_EXPOSURE_ACTIVE"
XI_PRM_EXPOSURE_BURST_COUNT = {pulses}

{_matrix_vision(widths)}"""

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the pulses, adding the camera's bias to each."""
        table = tomllib.loads(text, parse_float=Decimal)
        pulses = table["pulses"]
        bias = _ns(pulses["on_bias_us"])
        time_ns = _ns(pulses["first_delay_us"])
        edges: list[tuple[int, int]] = []
        for width, gap in zip(pulses["widths_us"], [*pulses["gaps_us"], Decimal(0)], strict=True):
            edges += [(time_ns, 1), (time_ns + _ns(width) + bias, 0)]
            time_ns += _ns(width) + _ns(gap)
        return Program.from_edges(edges, chip_ns=table["chip_ns"], chips=table["chips"])


def _matrix_vision(widths_ns: list[int]) -> str:
    if len(set(widths_ns)) > 1:
        return (
            "# Balluff, MATRIX VISION: mvMultiExposureCount is documented for openings of one"
            " length only.\n"
        )
    return f"""\
[matrix_vision]  # Balluff, MATRIX VISION: GenICam names, each pulse starts one exposure
ExposureMode = "Timed"
ExposureTime = {microseconds(widths_ns[0])}
mvMultiExposureCount = {len(widths_ns)}
"""


def _list(times_ns: list[int]) -> str:
    if not times_ns:
        return ""
    rows = item_rows([microseconds(time_ns) for time_ns in times_ns], per_line=8)
    return f"\n{rows},\n"


def _ns(time_us: Decimal) -> int:
    # decimals, not floats: microseconds with three digits are exact nanoseconds
    return int(time_us * 1000)
