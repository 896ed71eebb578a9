"""Gyro recordings: exact integration, axis signs, and one clear line for every bad file."""

from pathlib import Path

import numpy as np
import pytest

from motdiff.gyro import GyroTrace, image_rates_rad_s, roll_rad, trajectory_from_gyro
from motdiff.io.gyro_tables import read_gyro


def trace(rate: np.ndarray, rate_hz: float = 200.0, start_s: float = 0.0) -> GyroTrace:
    return GyroTrace(start_s + np.arange(len(rate)) / rate_hz, rate)


def test_constant_yaw_is_a_uniform_straight_motion_to_the_right() -> None:
    steady = trace(np.tile([0.0, 0.05, 0.0], (100, 1)))
    motion = trajectory_from_gyro(steady, focal_px=1000, start_s=0.1013, exposure_s=0.2)
    assert motion.direction == "known"
    assert motion.length_px == pytest.approx(10)  # 1000 px * 0.05 rad/s * 0.2 s
    np.testing.assert_allclose(motion.xy, np.column_stack([10 * (motion.t - 0.5), 0 * motion.t]), atol=1e-9)


def test_constant_pitch_moves_the_scene_down_and_roll_not_at_all() -> None:
    motion = trajectory_from_gyro(trace(np.tile([0.05, 0, 3.0], (100, 1))), focal_px=1000, start_s=0, exposure_s=0.2)
    assert motion.y[-1] - motion.y[0] == pytest.approx(10)
    assert np.ptp(motion.x) == pytest.approx(0, abs=1e-9)


def test_the_default_signs_are_those_of_a_pinhole_camera() -> None:
    # phone axes x right, y up, z to the user; the rear camera looks along -z; a far point straight ahead
    def image_of(rotation: np.ndarray) -> tuple[float, float]:
        x, y, z = rotation.T @ np.array([0.0, 0.0, -1.0])  # the point in the turned phone's axes
        return x / -z, -y / -z  # right, down

    def turned(axis: int, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = c
        matrix[j, i], matrix[i, j] = s, -s
        return matrix

    angle = 1e-4
    for axis in (0, 1):
        rate = np.zeros((3, 3))
        rate[:, axis] = angle  # over one second
        motion = trajectory_from_gyro(trace(rate, 1.0), focal_px=1.0, start_s=0, exposure_s=1.0)
        moved = motion.xy[-1] - motion.xy[0]
        np.testing.assert_allclose(moved, image_of(turned(axis, angle)), atol=1e-10)


def test_sine_rate_integrates_to_a_cosine() -> None:
    freq_hz, rate_hz = 6.0, 1000.0
    t = np.arange(1000) / rate_hz
    rate = np.column_stack([0 * t, np.sin(2 * np.pi * freq_hz * t), 0 * t])
    motion = trajectory_from_gyro(GyroTrace(t, rate), focal_px=100, start_s=0.1234, exposure_s=0.25)
    absolute = 0.1234 + 0.25 * motion.t
    expected = -100 * np.cos(2 * np.pi * freq_hz * absolute) / (2 * np.pi * freq_hz)
    shift = motion.x - expected
    assert np.ptp(shift) < 1e-3


def test_exact_between_rows_for_linear_rates_at_uneven_times() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.001, 0.01, 200))
    rate = np.column_stack([2 * t, 3 * t - 1, 0 * t])
    motion = trajectory_from_gyro(GyroTrace(t, rate), focal_px=10, start_s=0.3, exposure_s=0.4)
    s = 0.3 + 0.4 * motion.t
    x = 10 * (1.5 * s**2 - s)
    np.testing.assert_allclose(np.diff(motion.x), np.diff(x), atol=1e-12)
    np.testing.assert_allclose(np.diff(motion.y), np.diff(10 * s**2), atol=1e-12)


def test_a_large_clock_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    rate = rng.standard_normal((400, 3)) * 0.05
    a = trajectory_from_gyro(trace(rate), focal_px=800, start_s=0.5, exposure_s=0.3)
    b = trajectory_from_gyro(trace(rate, start_s=250_000.0), focal_px=800, start_s=250_000.5, exposure_s=0.3)
    t = np.linspace(0, 1, 50)
    np.testing.assert_allclose(a.at(t), b.at(t), atol=1e-5)


def test_axes_choose_and_flip() -> None:
    rate = np.random.default_rng(0).standard_normal((10, 3))
    np.testing.assert_array_equal(image_rates_rad_s(trace(rate), axes=("-x", "+z")), rate[:, [0, 2]] * [-1, 1])
    for bad in (("x", "y"), ("+x", "-x"), ("+x",), ("+x", "+w")):
        with pytest.raises(ValueError, match="axes"):
            image_rates_rad_s(trace(rate), axes=bad)


def test_roll_is_reported() -> None:
    rate = np.tile([0.1, 0.2, 0.03], (100, 1))
    assert roll_rad(trace(rate), start_s=0.1, exposure_s=0.2) == pytest.approx(0.006)
    assert roll_rad(trace(rate), start_s=0.1, exposure_s=0.2, axes=("+z", "+x")) == pytest.approx(0.04)


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


ROWS = np.column_stack([np.arange(50) * 5_000_000 + 10**14, *np.random.default_rng(0).standard_normal((3, 50))])


@pytest.mark.parametrize("separator", ["\t", ",", ";", "  ", ", "])
@pytest.mark.parametrize("header", ["", "t_ns{0}wx{0}wy{0}wz\n", "timestamp{0}gyro_x{0}gyro_y{0}gyro_z\n"])
def test_reading_tables(tmp_path: Path, separator: str, header: str) -> None:
    path = tmp_path / "gyro.csv"
    body = "\n".join(separator.join([f"{row[0]:.0f}", *(f"{v:.17g}" for v in row[1:])]) for row in ROWS)
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
def test_the_unit_may_be_said_in_the_call_or_the_header(tmp_path: Path, unit: str, scale: float) -> None:
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
    with pytest.raises(ValueError, match=r"gyro.csv: not a text file in UTF-8, save it as UTF-8 \("):
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
    "phyphox": '"Gyroscope z (rad/s)","Absolute (rad/s)","Gyroscope y (rad/s)","Gyroscope x (rad/s)","Time (s)"',
    "Sensor Logger": "z,accuracy,y,x,seconds_elapsed",
    "EuRoC": "#w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],w_RS_S_y [rad s^-1],w_RS_S_x [rad s^-1],timestamp [s]",
    "SensorLog": "gyroRotationZ(rad/s),accelerometerX(G),gyroRotationY(rad/s),gyroRotationX(rad/s),"
    "gyroTimestamp_sinceReboot(s)",
    "motion": "motionRotationRateZ(rad/s),motionYaw(rad),motionRotationRateY(rad/s),motionRotationRateX(rad/s),"
    "motionTimestamp_sinceReboot(s)",
    "ROS": "field.angular_velocity.z,field.linear_acceleration.x,field.angular_velocity.y,field.angular_velocity.x,"
    "%time_secs",
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
    ["gx_dps,gy_dps,gz_dps", "wx [deg/s],wy [deg/s],wz [deg/s]", "gyro_x(deg/s),gyro_y(deg/s),gyro_z(deg/s)",
     "Gyroscope X (°/s),Gyroscope Y (°/s),Gyroscope Z (°/s)", "x_deg_per_s,y_deg_per_s,z_deg_per_s",
     "gyro_x (degrees/second),gyro_y (degrees/second),gyro_z (degrees/second)"],
)  # fmt: skip
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
        np.testing.assert_allclose(read_gyro(path, rate_unit="deg").rate_rad_s[0], [np.pi, np.pi / 2, 0])
        np.testing.assert_array_equal(read_gyro(path).rate_rad_s[0], [180, 90, 0])
    with pytest.raises(ValueError, match="rate_unit: must be one of rad, deg"):
        read_gyro(path, rate_unit="rpm")  # type: ignore[arg-type]


@pytest.mark.parametrize("names", ["gx [mdps],gy [mdps],gz [mdps]", "wx [deg/s],wy [rad/s],wz [deg/s]"])
def test_rates_in_unknown_or_different_units_are_not_guessed_at(tmp_path: Path, names: str) -> None:
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
