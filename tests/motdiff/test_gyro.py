"""Gyro recordings: exact integration, axis signs, and one clear line for every bad file."""

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace, image_rates_rad_s, roll_rad, trajectory_from_gyro


def trace(rate: np.ndarray, rate_hz: float = 200.0, start_s: float = 0.0) -> GyroTrace:
    return GyroTrace(start_s + np.arange(len(rate)) / rate_hz, rate)


def test_constant_yaw_is_a_uniform_straight_motion_to_the_left() -> None:
    steady = trace(
        np.tile([0.0, 0.05, 0.0], (100, 1))
    )  # about the axis that points down: the camera pans right
    motion = trajectory_from_gyro(steady, focal_px=1000, start_s=0.1013, exposure_s=0.2)
    assert motion.direction == "known"
    assert motion.length_px == pytest.approx(10)  # 1000 px * 0.05 rad/s * 0.2 s
    np.testing.assert_allclose(
        motion.xy, np.column_stack([10 * (0.5 - motion.t), 0 * motion.t]), atol=1e-9
    )


def test_constant_pitch_moves_the_scene_down_and_roll_not_at_all() -> None:
    motion = trajectory_from_gyro(
        trace(np.tile([0.05, 0, 3.0], (100, 1))), focal_px=1000, start_s=0, exposure_s=0.2
    )
    assert motion.y[-1] - motion.y[0] == pytest.approx(10)
    assert np.ptp(motion.x) == pytest.approx(0, abs=1e-9)


DIRECTIONS = {  # in a camera's own axes: right, down, forward
    "right": (1, 0, 0),
    "left": (-1, 0, 0),
    "down": (0, 1, 0),
    "up": (0, -1, 0),
    "forward": (0, 0, 1),
    "back": (0, 0, -1),
}
RIGHT_HANDED = [
    names
    for names in permutations(DIRECTIONS, 3)
    if np.linalg.det(np.array([DIRECTIONS[name] for name in names])) > 0.5
]


@pytest.mark.parametrize("names", RIGHT_HANDED, ids=",".join)
def test_a_pinhole_camera_sees_the_path_whatever_the_axes_of_its_gyroscope(
    names: tuple[str, str, str],
) -> None:
    """A far point ahead, in the axes of a camera turned about each axis of the sensor by
    Rodrigues' formula."""
    angle = 1e-4
    for axis, name in enumerate(names):
        a, b, c = DIRECTIONS[name]
        cross = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        turned = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        right, down, forward = turned.T @ [0, 0, 1]  # the point in the turned camera's axes
        rate = np.zeros((3, 3))
        rate[:, axis] = angle  # over one second
        window = {"start_s": 0.0, "exposure_s": 1.0, "axes": ",".join(names)}
        motion = trajectory_from_gyro(trace(rate, 1.0), focal_px=1.0, **window)
        np.testing.assert_allclose(
            motion.xy[-1] - motion.xy[0], [right / forward, down / forward], atol=1e-10
        )
        about_the_line_of_sight = name in ("forward", "back")
        assert roll_rad(trace(rate, 1.0), **window) == pytest.approx(
            angle * about_the_line_of_sight
        )


def test_the_default_axes_are_those_of_the_camera() -> None:
    rate = np.random.default_rng(0).standard_normal((10, 3))
    assert len(RIGHT_HANDED) == 24
    np.testing.assert_array_equal(
        image_rates_rad_s(trace(rate)), np.stack([-rate[:, 1], rate[:, 0]], axis=1)
    )
    np.testing.assert_array_equal(
        image_rates_rad_s(trace(rate)), image_rates_rad_s(trace(rate), axes="right, down, forward")
    )


def test_sine_rate_integrates_to_a_cosine() -> None:
    freq_hz = 6.0
    rate_hz = 1000.0
    t = np.arange(1000) / rate_hz
    rate = np.column_stack([0 * t, np.sin(2 * np.pi * freq_hz * t), 0 * t])
    motion = trajectory_from_gyro(
        GyroTrace(t, rate), focal_px=100, start_s=0.1234, exposure_s=0.25
    )
    absolute = 0.1234 + 0.25 * motion.t
    expected = 100 * np.cos(2 * np.pi * freq_hz * absolute) / (2 * np.pi * freq_hz)
    shift = motion.x - expected
    assert np.ptp(shift) < 1e-3


def test_exact_between_rows_for_linear_rates_at_uneven_times() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.001, 0.01, 200))
    rate = np.column_stack([2 * t, 3 * t - 1, 0 * t])
    motion = trajectory_from_gyro(GyroTrace(t, rate), focal_px=10, start_s=0.3, exposure_s=0.4)
    s = 0.3 + 0.4 * motion.t
    x = 10 * (1.5 * s**2 - s)
    np.testing.assert_allclose(np.diff(motion.x), -np.diff(x), atol=1e-12)
    np.testing.assert_allclose(np.diff(motion.y), np.diff(10 * s**2), atol=1e-12)


def test_a_large_clock_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    rate = rng.standard_normal((400, 3)) * 0.05
    a = trajectory_from_gyro(trace(rate), focal_px=800, start_s=0.5, exposure_s=0.3)
    b = trajectory_from_gyro(
        trace(rate, start_s=250_000.0), focal_px=800, start_s=250_000.5, exposure_s=0.3
    )
    t = np.linspace(0, 1, 50)
    np.testing.assert_allclose(a.at(t), b.at(t), atol=1e-5)


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ("right,up,forward", "right-handed"),
        ("right,left,up", "right angles"),
        ("right,right,up", "right angles"),
        ("right,down", "of right, left, down, up, forward, back; got 'right,down'"),
        ("+x,-y,z", "directions of x, y and z"),
        ("", "directions of x, y and z"),
    ],
)
def test_axes_that_no_gyroscope_has_are_refused(axes: str, said: str) -> None:
    with pytest.raises(ValueError, match=f"^axes: .*{said}"):
        image_rates_rad_s(trace(np.ones((10, 3))), axes=axes)


@pytest.mark.parametrize(
    ("window", "said"),
    [
        ({"start_s": -0.1, "exposure_s": 0.1}, "within the trace"),
        ({"start_s": 0.45, "exposure_s": 0.1}, "within the trace"),
        ({"start_s": 0.1, "exposure_s": 0.0}, "exposure_s"),
        ({"start_s": 0.1, "exposure_s": 0.1, "focal_px": -5.0}, "focal_px"),
        ({"start_s": float("nan"), "exposure_s": 0.1}, "within the trace"),
    ],
)
def test_windows_outside_the_trace_are_refused(window: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        trajectory_from_gyro(trace(np.ones((101, 3))), **{"focal_px": 100.0, **window})


ROWS = np.column_stack(
    [np.arange(50) * 5_000_000 + 10**14, *np.random.default_rng(0).standard_normal((3, 50))]
)


@pytest.mark.parametrize("separator", ["\t", ",", ";", "  ", ", "])
@pytest.mark.parametrize(
    "header", ["", "t_ns{0}wx{0}wy{0}wz\n", "timestamp{0}gyro_x{0}gyro_y{0}gyro_z\n"]
)
def test_reading_tables(tmp_path: Path, separator: str, header: str) -> None:
    path = tmp_path / "gyro.csv"
    body = "\n".join(
        separator.join([f"{row[0]:.0f}", *(f"{v:.17g}" for v in row[1:])]) for row in ROWS
    )
    path.write_text("# phone\n" + header.format(separator) + body + "\n\n")
    read = read_gyro(path)
    np.testing.assert_allclose(read.t_s, ROWS[:, 0] * 1e-9)
    np.testing.assert_array_equal(read.rate_rad_s, ROWS[:, 1:])
    assert read.sample_rate_hz == pytest.approx(200)
    assert read.duration_s == pytest.approx(49 * 0.005)


def test_columns_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text("wz (rad/s),accel x,wy [rad/s],WX,time [s]\n3,9,2,1,0.00\n6,9,5,4,0.01\n")
    read = read_gyro(path)
    np.testing.assert_array_equal(read.rate_rad_s, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(read.t_s, [0, 0.01])


@pytest.mark.parametrize(("unit", "scale"), [("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0)])
def test_the_unit_may_be_said_in_the_call_or_the_header(
    tmp_path: Path, unit: str, scale: float
) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text("0,1,2,3\n7,4,5,6\n")
    assert read_gyro(path, time_unit=unit).duration_s == pytest.approx(7 * scale)  # type: ignore[arg-type]
    path.write_text(f"t_{unit},x,y,z\n0,1,2,3\n7,4,5,6\n")
    assert read_gyro(path).duration_s == pytest.approx(7 * scale)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no rows"),
        ("# only a remark\n", "no rows"),
        ("t_s,wx,wy,wz\n", "at least 2 rows"),
        ("0.0,1,2,3\n", "at least 2 rows"),
        ("0.00,1,2,3\n0.01,1,2\n", "line 2 has 3 columns"),
        ("0.00,1,2,3\n0.01,1,two,3\n", "line 2 holds something that is not a number"),
        ("0.00,1,2,3\n0.01,1,,3\n", "line 2 holds something that is not a number"),
        ("0.00,1,2,3\n0.01,1,nan,3\n", "line 2 holds NaN"),
        ("0.00,1,2,3\n0.01,1,2,3\n0.01,1,2,3\n", "line 3 does not"),
        ("0.02,1,2,3\n0.01,1,2,3\n", "line 2 does not"),
        ("t_s,wx,wz\n0.00,1,2\n0.01,1,2\n", "missing column wy"),
        ("wx,wy,wz\n1,2,3\n1,2,3\n", "missing column timestamp"),
        ("0,1,2,3\n7,1,2,3\n", "name the unit"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        read_gyro(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_another_encoding_is_told_what_would_be_right(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_bytes("t_s,wx,wy,wz\n0.00,1,2,3\n# 3 °/s\n0.01,1,2,3\n".encode(encoding))
    with pytest.raises(
        ValueError, match=r"gyro.csv: not a text file in UTF-8, save it as UTF-8 \("
    ):
        read_gyro(path)


def test_binary_and_missing_files(tmp_path: Path) -> None:
    path = tmp_path / "gyro.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(ValueError, match="not a text file"):
        read_gyro(path)
    with pytest.raises(FileNotFoundError):
        read_gyro(tmp_path / "none.csv")
    path.write_text("0.00,1,2,3\n0.01,1,2,3\n")
    with pytest.raises(ValueError, match="time_unit"):
        read_gyro(path, time_unit="h")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("t", "rate", "said"),
    [
        ([0.0, 1.0], np.zeros((2, 2)), "rate_rad_s"),
        ([0.0], np.zeros((1, 3)), "at least 2"),
        ([0.0, 0.0], np.zeros((2, 3)), "row 2 does not follow"),
        ([0.0, 1.0], np.full((2, 3), np.nan), "NaN"),
    ],
)
def test_bad_traces(t: list[float], rate: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        GyroTrace(np.array(t), rate)


VALUES = "3,9,2,1,0.00\n6,9,5,4,0.01\n"  # z, another sensor, y, x, time
LOGGERS = {
    "plain": "wz,ax,wy,wx,t_s",
    "brackets": "wz [rad/s],ax [m/s^2],wy [rad/s],wx [rad/s],time [s]",
    "round brackets": "gyro_z(rad/s),acc_x(m/s2),gyro_y(rad/s),gyro_x(rad/s),timestamp(s)",
    "phyphox": (
        '"Gyroscope z (rad/s)","Absolute (rad/s)","Gyroscope y (rad/s)","Gyroscope x'
        ' (rad/s)","Time (s)"'
    ),
    "Sensor Logger": "z,accuracy,y,x,seconds_elapsed",
    "EuRoC": (
        "#w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],w_RS_S_y [rad s^-1],w_RS_S_x [rad"
        " s^-1],timestamp [s]"
    ),
    "SensorLog": (
        "gyroRotationZ(rad/s),accelerometerX(G),gyroRotationY(rad/s),gyroRotationX(rad/s),"
        "gyroTimestamp_sinceReboot(s)"
    ),
    "motion": (
        "motionRotationRateZ(rad/s),motionYaw(rad),motionRotationRateY(rad/s),motionRotationRateX(rad/s),"
        "motionTimestamp_sinceReboot(s)"
    ),
    "ROS": (
        "field.angular_velocity.z,field.linear_acceleration.x,field.angular_velocity.y,field.angular_velocity.x,"
        "%time_secs"
    ),
    "capitals": "GYRO_Z,ACC_X,GYRO_Y,GYRO_X,TIME_S",
    "a remark": "# gz ax gy gx time_sec",
    "spaces": "wz (rad/s) ax (g) wy (rad/s) wx (rad/s) t (s)",
    "another sensor's x, y, z": "gz,x,gy,gx,t_sec",
}


@pytest.mark.parametrize("logger", LOGGERS)
def test_headers_of_common_loggers(tmp_path: Path, logger: str) -> None:
    path = tmp_path / "gyro.csv"
    values = VALUES.replace(",", " ") if logger == "spaces" else VALUES
    path.write_text(f"{LOGGERS[logger]}\n{values}")
    read = read_gyro(path)
    np.testing.assert_array_equal(read.rate_rad_s, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(read.t_s, [0, 0.01])


@pytest.mark.parametrize(
    "names",
    [
        "gx_dps,gy_dps,gz_dps",
        "wx [deg/s],wy [deg/s],wz [deg/s]",
        "gyro_x(deg/s),gyro_y(deg/s),gyro_z(deg/s)",
        "Gyroscope X (°/s),Gyroscope Y (°/s),Gyroscope Z (°/s)",
        "x_deg_per_s,y_deg_per_s,z_deg_per_s",
        "gyro_x (degrees/second),gyro_y (degrees/second),gyro_z (degrees/second)",
    ],
)
def test_rates_in_degrees_by_the_header(tmp_path: Path, names: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(f"t_s,{names}\n0,180,90,0\n0.01,0,-90,360\n", encoding="utf-8")
    expected = np.pi * np.array([[1, 0.5, 0], [0, -0.5, 2]])
    np.testing.assert_allclose(read_gyro(path).rate_rad_s, expected)
    np.testing.assert_allclose(read_gyro(path, rate_unit="deg").rate_rad_s, expected)
    np.testing.assert_array_equal(read_gyro(path, rate_unit="rad").rate_rad_s[0], [180, 90, 0])


def test_the_unit_of_rates_may_be_said_in_the_call(tmp_path: Path) -> None:
    path = tmp_path / "gyro.csv"
    for text in ("0,180,90,0\n0.01,0,-90,360\n", "t_s,wx,wy,wz\n0,180,90,0\n0.01,0,-90,360\n"):
        path.write_text(text)
        np.testing.assert_allclose(
            read_gyro(path, rate_unit="deg").rate_rad_s[0], [np.pi, np.pi / 2, 0]
        )
        np.testing.assert_array_equal(read_gyro(path).rate_rad_s[0], [180, 90, 0])
    with pytest.raises(ValueError, match="rate_unit: must be one of rad, deg"):
        read_gyro(path, rate_unit="rpm")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "names", ["gx [mdps],gy [mdps],gz [mdps]", "wx [deg/s],wy [rad/s],wz [deg/s]"]
)
def test_rates_in_unknown_or_different_units_are_not_guessed_at(
    tmp_path: Path, names: str
) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(f"t_s,{names}\n0,180,90,0\n0.01,0,-90,360\n")
    with pytest.raises(ValueError, match="missing column wx"):
        read_gyro(path)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_decimal_comma(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text("t_s;wx;wy;wz\n0,00;1,5;2;3\n0,01;4;-5,25;6\n".replace(";", separator))
    read = read_gyro(path)
    np.testing.assert_array_equal(read.t_s, [0, 0.01])
    np.testing.assert_array_equal(read.rate_rad_s, [[1.5, 2, 3], [4, -5.25, 6]])


COUNT = 60
CLOCK_S = 0.005 * np.arange(COUNT)
RATES = np.round(0.1 * np.random.default_rng(1).standard_normal((COUNT, 3)), 5)


def write(path: Path, header: str, row: str, *, per_s: float = 1.0, decimals: int = 4) -> Path:
    """Write rows with ``t``, ``x``, ``y`` and ``z`` in place of the names, below lines of
    ``header``."""
    cells = [
        row.format(t=f"{t * per_s:.{decimals}f}", x=x, y=y, z=z)
        for t, (x, y, z) in zip(CLOCK_S, RATES.tolist(), strict=True)
    ]
    path.write_text(header + "\n".join(cells) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "row", "per_s"),
    [
        ("", "{x},{y},{z},{t}", 1.0),
        ("", "{x},{t},{y},{z}", 1.0),
        ("", "{x} {y} {z} {t}", 1e9),
        ("", "{t},{x},{y},{z},9.8,0.1,0.2", 1e6),
        ("Device: phone\nrate 200\n", "{t},{x},{y},{z}", 1.0),
    ],
)
def test_without_a_header_the_time_is_the_column_that_rises(
    tmp_path: Path, header: str, row: str, per_s: float
) -> None:
    read = read_gyro(
        write(tmp_path / "gyro.csv", header, row, per_s=per_s, decimals=4 if per_s == 1 else 0)
    )
    np.testing.assert_array_equal(read.rate_rad_s, RATES)
    np.testing.assert_allclose(read.t_s, CLOCK_S, atol=1e-12)
    (warning,) = read.warnings
    time, *_ = [
        place for place, name in enumerate(row.replace(",", " ").split(), 1) if name == "{t}"
    ]
    assert (
        f"gyro.csv: not stated in the file, and taken for granted: column {time} is the time"
        in warning
    )
    assert read.columns.startswith(f"time: column {time}, in ")


@pytest.mark.parametrize(
    "row", ["{x},{y},{z},0.3,{t}", "{t},{t},{x},{y},{z}", "{n},{t},{x},{y},{z}"]
)
def test_without_a_header_columns_that_could_be_others_are_not_guessed_at(
    tmp_path: Path, row: str
) -> None:
    path = write(tmp_path / "gyro.csv", "", row.replace("{n}", "N"))
    path.write_text(
        "\n".join(
            line.replace("N", str(i)) for i, line in enumerate(path.read_text().splitlines())
        )
    )
    with pytest.raises(
        ValueError,
        match=r"gyro.csv: columns? .* rises? as a time does; a header .* must name them",
    ):
        read_gyro(path)


def test_without_a_header_a_late_column_of_milliseconds_is_refused_for_what_it_is(
    tmp_path: Path,
) -> None:
    path = write(tmp_path / "gyro.csv", "", "{x},{y},{z},{t}", per_s=1e3, decimals=0)
    with pytest.raises(
        ValueError, match=r"column 4 rises as a time .* first one does not; .*t_ms must name them"
    ):
        read_gyro(path)


HEADS = {
    "ArduPilot": ("TimeUS,I,GyrX,GyrY,GyrZ,AccX\n", "{t},0,{x},{y},{z},9.8", 1e6),
    "PX4": (
        "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt\n",
        "{t},{x},{y},{z},4000",
        1e6,
    ),
    "GoPro": (
        '"cts","date","Gyroscope (z) [rad/s]","Gyroscope (x) [rad/s]","Gyroscope (y) [rad/s]"\n',
        "{t},2020-01-01T00:00:00.000Z,{z},{x},{y}",
        1e3,
    ),
    "indices": (
        "t_us;angular_velocity[0];angular_velocity[1];angular_velocity[2]\n",
        "{t};{x};{y};{z}",
        1e6,
    ),
    "above it": ("Device: phone\nrange,0.1,0.2,0.3\n\nt_us,wx,wy,wz\n", "{t},{x},{y},{z}", 1e6),
    "remarks": ("# phone\n# t_us wx wy wz\n# begin\n", "{t} {x} {y} {z}", 1e6),
    "units below": ("time,gyro_x,gyro_y,gyro_z\nms,rad/s,rad/s,rad/s\n", "{t},{x},{y},{z}", 1e3),
    "empty last column": ("t_us,wx,wy,wz,\n", "{t},{x},{y},{z},", 1e6),
    "quoted": ("t_us,wx,wy,wz,place\n", '{t},{x},"{y}",{z},"a, b"', 1e6),
}


@pytest.mark.parametrize("name", HEADS)
def test_heads_of_flight_controllers_and_cameras(tmp_path: Path, name: str) -> None:
    header, row, per_s = HEADS[name]
    read = read_gyro(write(tmp_path / "gyro.csv", header, row, per_s=per_s, decimals=0))
    np.testing.assert_array_equal(read.rate_rad_s, RATES)
    np.testing.assert_allclose(read.t_s, CLOCK_S, atol=1e-12)


def test_what_the_file_does_not_state_is_said(tmp_path: Path) -> None:
    row = "{t},{x},{y},{z}"
    stated = read_gyro(
        write(tmp_path / "a.csv", "t_s,gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)\n", row)
    )
    assert stated.warnings == ()
    assert (
        stated.columns
        == "time: t_s, in s; rates: gyro_x (rad/s), gyro_y (rad/s), gyro_z (rad/s), in rad/s"
    )
    bare = write(tmp_path / "b.csv", "time,x,y,z\n", row)
    (warning,) = read_gyro(bare).warnings
    for assumed in ("x, y, z are a gyroscope's", "times in s", "rates in rad/s"):
        assert assumed in warning
    (warning,) = read_gyro(bare, time_unit="s", rate_unit="rad").warnings
    assert warning.endswith("granted: x, y, z are a gyroscope's")


SENSORS = {
    "sensor": "gyroscope",
    "type": "TYPE_GYROSCOPE",
    "kind": "Gyro",
    "name": "android.sensor.gyroscope",
}


@pytest.mark.parametrize("column", SENSORS)
def test_of_several_sensors_the_rows_of_the_gyroscope_are_read(
    tmp_path: Path, column: str
) -> None:
    path = write(
        tmp_path / "imu.csv", f"t_s,{column},x,y,z\n", f"{{t}},{SENSORS[column]},{{x}},{{y}},{{z}}"
    )
    head, *rows = path.read_text().splitlines()
    others = [f"{0.005 * i + 0.001:.4f},accelerometer,0.1,9.81,0.2" for i in range(COUNT)]
    path.write_text(
        "\n".join([head, *(line for pair in zip(rows, others, strict=True) for line in pair)])
    )
    read = read_gyro(path)
    np.testing.assert_array_equal(read.rate_rad_s, RATES)
    np.testing.assert_allclose(read.t_s, CLOCK_S, atol=1e-12)
    assert f"{column}: {SENSORS[column]}" in read.columns


@pytest.mark.parametrize(
    ("column", "labels", "said"),
    [
        ("sensor", ("1", "4"), "column sensor holds 1, 4"),
        (
            "sensor",
            ("accelerometer", "magnetometer"),
            "column sensor holds accelerometer, magnetometer",
        ),
        ("label", ("accelerometer", "accelerometer"), "column label holds accelerometer"),
        (
            "sensor",
            ("gyroscope left", "gyroscope right"),
            "column sensor holds gyroscope left, gyroscope right",
        ),
        ("I", ("0", "1"), "60 of 120 rows repeat the time .* two sensors"),
    ],
)
def test_sensors_that_cannot_be_told_apart_are_refused(
    tmp_path: Path, column: str, labels: tuple[str, str], said: str
) -> None:
    lines = write(tmp_path / "imu.csv", "", "{t},LABEL,{x},{y},{z}").read_text().splitlines()
    path = tmp_path / "imu.csv"
    rows = [line.replace("LABEL", label) for line in lines for label in labels]
    path.write_text("\n".join([f"t_s,{column},x,y,z", *rows]))
    with pytest.raises(ValueError, match=f"imu.csv: .*{said}"):
        read_gyro(path)


def test_text_columns_that_name_no_sensor_are_passed_over(tmp_path: Path) -> None:
    path = write(
        tmp_path / "gyro.csv",
        "t_s,activity,accuracy,wx,wy,wz\n",
        "{t},walking,HIGH_ACCURACY,{x},{y},{z}",
    )
    np.testing.assert_array_equal(read_gyro(path).rate_rad_s, RATES)


def test_one_repeated_time_leaves_one_row_out(tmp_path: Path) -> None:
    path = write(tmp_path / "gyro.csv", "t_s,wx,wy,wz\n", "{t},{x},{y},{z}")
    whole = read_gyro(path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:41], lines[40].replace("-", ""), *lines[41:]]))
    read = read_gyro(path)
    np.testing.assert_array_equal(read.t_s, whole.t_s)
    np.testing.assert_array_equal(read.rate_rad_s, whole.rate_rad_s)
    assert f"{path}: line 42 repeats the time of the row before and is left out" in read.warnings
    path.write_text("\n".join([*lines[:41], lines[38], *lines[41:]]))
    with pytest.raises(ValueError, match="line 42 does not"):
        read_gyro(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,wx,wy,wz\n0.00,1,2,3,4\n0.01,1,2,3,4\n", "line 2 has 5 columns, wanted 4"),
        ("0.00,1,2,3\n0.01,1,2,3,4\n", "line 2 has 5 columns, wanted 4"),
        ("1,2,3,1e400\n1,2,3,1e400\n", "line 1 holds NaN or infinity"),
        ("a word, another, more, words\n" * 2000, "missing column timestamp"),
        ("t_s,wx,wy,wz\n0,00,0,1,0,2,0,3\n0,01,0,1,0,2,0,3\n", "line 2 has 8 columns, wanted 4"),
        ("t_s,wx,acc,wy,wz\n0.00,1,9,2,3\n0.01,1,2,3\n", "line 3 has 4 columns, wanted 5"),
        (
            "t_s,wx,wy,wz\n0.00,1,2,3\n0.01,1,lost,3\n",
            "line 3 holds .* not a number in column wy: 'lost'",
        ),
        (
            "time,wx,wy,wz\n2024-01-01,1,2,3\n2024-01-02,1,2,3\n",
            "line 2 .* in column time: '2024-01-01'",
        ),
        ("gyro,0.00,1,2,3\nacc,0.01,1,2,3\n", "line 1 begins with 'gyro'.* no header"),
        (
            "time,x,y,z\ns,furlongs,rad/s,rad/s\n0.00,1,2,3\n0.01,1,2,3\n",
            "line 2 holds no numbers, and no units",
        ),
    ],
)
def test_the_refusal_names_what_is_wrong(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"gyro.csv: .*{said}"):
        read_gyro(path)
