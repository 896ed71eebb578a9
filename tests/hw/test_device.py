import pytest

from hw.device import DeviceProfile, load_profile, parse_profile, profile_names, refusal
from hw.program import Program
from hw.recordings.recording_file import read_recording

RASKAR = "1010000111000001010000110011110111010111001001100111"


def test_all_violations_in_one_go():
    profile = DeviceProfile(
        name="narrow",
        tick_ns=300,
        min_chip_ns=300_000,
        max_chips=50,
        min_on_ns=250_000,
        max_on_ns=700_000,
        min_off_ns=300_000,
        max_duty=0.4,
        max_pulses=12,
        max_rate_hz=1000,
        dead_time_ns=250_000,
    )
    found = profile.check(Program(RASKAR, chip_ns=200_000))
    expected = [
        "chip of 200000 ns is not a whole number of 300 ns ticks; 199800 or 200100 ns would be",
        "chip of 200 us is too short; at least 300 us",
        "code of 52 chips is too long; at most 50",
        "shortest opening is 200 us; at least 250 us",
        "longest opening is 800 us; at most 700 us",
        "shortest gap between openings is 200 us; at least 300 us",
        "shortest gap between openings is 200 us; the dead time is 250 us",
        "duty is 0.500; at most 0.400",
        "code has 13 openings; at most 12",
        "openings come at up to 2500 Hz; at most 1000 Hz",
    ]
    assert found == tuple(f"narrow: {line}" for line in expected)


def test_limits_themselves_are_allowed():
    program = Program("110100", chip_ns=100)
    profile = DeviceProfile(
        name="exact",
        tick_ns=50,
        min_chip_ns=100,
        max_chip_ns=100,
        max_chips=6,
        min_on_ns=100,
        max_on_ns=200,
        min_off_ns=100,
        max_duty=0.5,
        max_pulses=2,
        max_rate_hz=1e9 / 300,
        dead_time_ns=100,
    )
    assert profile.check(program) == ()


def test_rest_before_and_after_is_no_gap():
    profile = DeviceProfile(name="slow", min_off_ns=10_000, dead_time_ns=10_000, max_rate_hz=1.0)
    assert profile.check(Program("0110", chip_ns=100)) == ()
    assert len(profile.check(Program("0101", chip_ns=100))) == 3


def test_own_exposure_time_shortens_what_can_be_commanded():
    profile = DeviceProfile(name="camera", on_bias_ns=30, tick_ns=10)
    assert profile.check(Program("1", chip_ns=40)) == ()
    assert profile.check(Program("1", chip_ns=30)) == (
        "camera: shortest opening is 30 ns; at least 40 ns (its own 30 ns included)",
    )


def test_chip_too_long():
    assert (
        "too long; at most 32.7675 ms"
        in load_profile("cxp-avr").check(Program("1", 33_000_000))[0]
    )


@pytest.mark.parametrize(
    ("chip_ns", "chips", "count"), [(50_000, 1024, 0), (49_500, 1025, 2), (50_100, 52, 1)]
)
def test_avr_profile(chip_ns, chips, count):
    assert len(load_profile("cxp-avr").check(Program("1" * chips, chip_ns))) == count


def test_built_in_profiles_load_under_their_own_names():
    assert {"generic", "cxp-avr"} <= set(profile_names())
    for name in profile_names():
        assert load_profile(name).name == name
    assert load_profile("generic").check(Program(RASKAR, chip_ns=1)) == ()


def test_liquid_crystals_have_ramps_and_others_none():
    assert {load_profile(name).rise_ns for name in ("generic", "cxp-avr")} == {0}
    flc = load_profile("flc")
    nematic = load_profile("lc-dual-frequency")
    assert 0 < flc.rise_ns == flc.fall_ns < nematic.rise_ns == nematic.fall_ns
    ramps = parse_profile('schema = "hw.device/1"\nname = "mine"\nrise_ns = 30\nfall_ns = 0\n')
    assert (ramps.rise_ns, ramps.fall_ns) == (30, 0)
    assert ramps.check(Program("101", chip_ns=40)) == ()  # a ramp limits no program


def test_users_profile_from_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('schema = "hw.device/1"\nname = "mine"\nmax_duty = 0.3\nclosed_level = 1\n')
    assert (
        load_profile(str(path))
        == load_profile(path)
        == DeviceProfile(name="mine", max_duty=0.3, closed_level=1)
    )


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("name = ", "not TOML"),
        ('name = "x"\nname = "y"', "not TOML"),
        ("", "has no name"),
        ('name = ""', "name is ''"),
        ("name = 5", "name is '5'"),
        ('name = "a\\nb"', "one line"),
        ('name = "x"\nmax_dutty = 0.3', "unknown field 'max_dutty'"),
        ('name = "x"\nmax_duty = nan', "finite"),
        ('name = "x"\nmax_duty = 0', "above 0"),
        ('name = "x"\nmax_duty = 1.5', "at most 1"),
        ('name = "x"\nmax_rate_hz = -1', "above 0"),
        ('name = "x"\nmin_on_ns = -1', "at least 0"),
        ('name = "x"\nmin_on_ns = 1.5', "whole number"),
        ('name = "x"\nmin_on_ns = true', "finite number"),
        ('name = "x"\nmin_on_ns = "5"', "finite number"),
        ('name = "x"\ntick_ns = 0', "at least 1"),
        ('name = "x"\nrise_ns = -1', "rise_ns is -1: it must be at least 0"),
        ('name = "x"\nfall_ns = 0.5', "whole number"),
        ('name = "x"\nclosed_level = 2', "0 or 1"),
        ('name = "x"\nmin_on_ns = 9\nmax_on_ns = 8', "must not exceed"),
        ('name = "x"\nmin_chip_ns = 9\nmax_chip_ns = 8', "must not exceed"),
    ],
)
def test_bad_profiles_get_one_clear_line(body, words):
    with pytest.raises(ValueError, match=r".") as caught:
        parse_profile(f'schema = "hw.device/1"\n{body}\n', source="mine.toml")
    assert str(caught.value).startswith("mine.toml")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_schema_is_needed():
    with pytest.raises(ValueError, match=r"hw\.device/1"):
        parse_profile('name = "x"')
    with pytest.raises(ValueError, match=r"'hw\.device/2'"):
        parse_profile('schema = "hw.device/2"\nname = "x"')


def test_bad_files_get_one_clear_line(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for name, words in [
        ("no-such", "built in are cxp-avr, cxp-rp2040, dmd-dlpc900"),
        (tmp_path / "missing.toml", "No such file"),
        (tmp_path, "cannot be read"),
        (binary, "not UTF-8"),
        ("a\0b.toml", "cannot be read"),
    ]:
        with pytest.raises(ValueError, match=r".") as caught:
            load_profile(name)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_a_profile_in_another_encoding_is_told_what_would_be_right(tmp_path, encoding):
    path = tmp_path / "mine.toml"
    path.write_bytes(
        'schema = "hw.device/1"\nname = "mine"\ndescription = "Ferré"\n'.encode(encoding)
    )
    with pytest.raises(ValueError, match=r"mine.toml is not UTF-8: .*save it as UTF-8") as caught:
        load_profile(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("read", "limit_mib"), [(load_profile, 1), (read_recording, 32)])
def test_a_file_too_large_for_its_kind_is_refused_before_it_is_parsed(tmp_path, read, limit_mib):
    path = tmp_path / "a.toml"
    with path.open("wb") as stream:
        stream.truncate(2**40)  # sparse: only a reader that takes it all would notice
    with pytest.raises(
        ValueError, match=rf"a\.toml cannot be read: it is too large, .* at most {limit_mib} MiB"
    ):
        read(path)


def test_a_profile_with_the_mark_of_windows_editors(tmp_path):
    plain = tmp_path / "plain.toml"
    marked = tmp_path / "marked.toml"
    plain.write_text('schema = "hw.device/1"\nname = "mine"\ntick_ns = 500\n')
    marked.write_bytes(b"\xef\xbb\xbf" + plain.read_bytes())
    assert load_profile(str(marked)) == load_profile(str(plain))


@pytest.mark.parametrize("name", profile_names())
def test_a_refusal_names_a_profile_only_where_the_device_says_its_tick_and_its_chips(name):
    """Of a device that does not say how many chips it holds, the tick alone tells no profile."""
    profile = load_profile(name)
    silent = DeviceProfile(name="board", tick_ns=profile.tick_ns)
    assert refusal(["board: too long"], silent) == "program cannot be played: board: too long"
    if profile.max_chips is not None:
        board = DeviceProfile(name="board", tick_ns=profile.tick_ns, max_chips=profile.max_chips)
        assert refusal(["board: too long"], board).endswith(f"with --device {name}")
