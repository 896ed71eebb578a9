import importlib.util
import socket
import struct
import subprocess
import sys
import threading
import time
from fractions import Fraction
from pathlib import Path

import pytest
from emulators.awg import Awg, Faults, message_end, split_outside
from emulators.scripted_port import imported_with
from emulators.tools import give_up
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.device import DeviceProfile
from hw.drivers.driver import Trust
from hw.drivers.scpi import ScpiAwg, ScpiLink
from hw.errors import DeviceError, WrongStateError
from hw.export import EXPORTERS
from hw.export.scpi import commands
from hw.port import LinkError, PortError
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, chip_ns=200_000)
SLOW = Program("1" * 100, chip_ns=300_000_000)  # 30 s: still open whenever a test looks
SIMULATED = Path(__file__).parents[2] / "emulators" / "awg_sim.yaml"


@pytest.fixture(autouse=True)
def _visa():
    for module in ("pyvisa", "pyvisa_py", "pyvisa_sim"):
        if importlib.util.find_spec(module) is None:
            give_up(f"{module} is not installed: pip install coded-exposure[visa] pyvisa-sim")


def execute(device, *lines):
    answers = []
    for line in lines:
        answers += device.execute(line if isinstance(line, bytes) else line.encode())
    return answers


def expected(program, *, opened=5.0, closed=0.0):
    """Edges in seconds after the trigger: the code begins one chip later."""
    chip = Fraction(program.chip_ns, 10**9)
    return [
        (chip + Fraction(at, 10**9), opened if level else closed) for at, level in program.edges
    ]


def same(found, wanted, program):
    """Whether edges agree: levels exactly, times to 1 ppm and the double precision of the rate."""
    assert [volts for _, volts in found] == pytest.approx([volts for _, volts in wanted])
    worst = max(abs(a - b) for (a, _), (b, _) in zip(found, wanted, strict=True))
    return worst <= Fraction(program.duration_ns + program.chip_ns, 10**9) / 10**6


def until(condition):
    deadline = time.monotonic() + 20
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def test_upload_sends_these_messages_and_no_others():
    program = Program("1101", chip_ns=200_000)
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        report = awg.upload(program, profile=DeviceProfile(name="shutter"))
        awg.arm()
        awg.trigger()
        awg.abort()
    sent = [message for message in device.messages if message != "SYST:ERR?"]
    assert sent == [
        "*IDN?",
        "OUTP OFF",
        "*CLS",
        "OUTP?",
        "VOLT MIN",
        "VOLT:OFFS 0",
        "OUTP OFF",
        "*CLS",
        "OUTP:LOAD INF",
        "DATA:VOL:CLE",
        "FORM:BORD SWAP",
        "DATA:ARB SHUTTER,<53 bytes>",
        "FUNC:ARB SHUTTER",
        "FUNC ARB",
        "FUNC:ARB:FILT OFF",
        "FUNC:ARB:SRAT 5000.000000",
        "VOLT:HIGH 5",
        "VOLT:LOW 0",
        "BURS:MODE TRIG",
        "BURS:NCYC 1",
        "BURS:PHAS 0",
        "TRIG:SOUR EXT",
        "TRIG:SLOP POS",
        "TRIG:DEL 0",
        "BURS:STAT ON",
        "FUNC:ARB:SRAT?",
        "OUTP OFF",
        "*CLS",
        "OUTP?",
        "BURS:STAT OFF",
        "BURS:STAT ON",
        "FUNC?",
        "BURS:MODE?",
        "BURS:NCYC?",
        "TRIG:SOUR?",
        "BURS:STAT?",
        "OUTP ON",
        "OUTP?",
        "TRIG",
        "OUTP OFF",
        "*CLS",
        "OUTP?",
    ]
    assert device.messages.count("SYST:ERR?") == 25  # one after each command but those of ABORT
    assert device.arbs == {"SHUTTER": [-1, 1, 1, -1, 1, -1, -1, -1]}
    assert (report.port, report.program) == (device.resource, program)
    assert (report.trust, report.read_back, report.armed, report.lease_ms) == (
        Trust.B,
        False,
        False,
        None,
    )
    assert report.firmware == "33522B 3.05-1.19-2.00-52-00"


codes = st.text("01", min_size=1, max_size=300).filter(lambda bits: "1" in bits)
chips = st.one_of(
    st.integers(16, 10**6), st.sampled_from([200_000, 300_000, 333_333, 1_000_000, 10**9])
)
programs = st.builds(lambda bits, chip_ns: Program(bits, chip_ns=chip_ns), codes, chips)
volts = st.integers(-9, 9)


def test_every_program_is_played_edge_for_edge_whatever_was_set_before():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:

        @settings(max_examples=60, deadline=None)
        @given(
            program=programs,
            inverted=st.booleans(),
            low=volts,
            span=st.integers(1, 9),
            load=st.sampled_from(["50", "INF"]),
        )
        def played(program, inverted, low, span, load):
            execute(
                device, f"OUTP:LOAD {load};:FUNC SQU;:VOLT MIN;:VOLT:OFFS {min(low, 10 - span)}"
            )
            execute(
                device,
                f"VOLT:HIGH {min(low, 10 - span) + span};:BURS:NCYC 7;PHAS 90;MODE GAT;:FORM:BORD"
                " NORM",
            )
            execute(device, "FUNC:ARB:FILT STEP;:TRIG:DEL 0.5;SLOP NEG;SOUR BUS;:OUTP ON")
            opened, closed = (0.0, 5.0) if inverted else (5.0, 0.0)
            awg.upload(
                program,
                profile=DeviceProfile(name="shutter", closed_level=int(inverted)),
                arm=True,
            )
            assert device.rest_volts == pytest.approx(closed)
            device._running = None
            device.trigger_input()
            assert same(device.plays[-1], expected(program, opened=opened, closed=closed), program)
            device._running = None

        played()
        assert device.errors == []


def test_output_is_never_live_before_it_is_armed_and_waits_for_its_trigger():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        execute(device, "FUNC SQU;:OUTP ON")
        before = device.free_runs
        awg.upload(PROGRAM)
        assert (device.output, device.free_runs) == (False, before)
        device.trigger_input()
        assert device.plays == []
        awg.arm()
        assert (device.rest_volts, device.free_runs) == (0.0, before)
        device.trigger_input()
        awg.abort()
        assert device.volts_now is None


def arm_again_and_again(awg):
    """Every way to arm and to disarm, one after another."""
    awg.upload(SHORT, arm=True)
    awg.arm()
    awg.trigger()
    awg.arm()
    awg.upload(SHORT, arm=True)
    awg.abort()
    awg.play()
    awg.arm()
    awg.play()
    awg.abort()


SHORT = Program("101", chip_ns=1000)


def test_arming_what_is_armed_or_plays_never_lets_the_output_run_freely():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        arm_again_and_again(awg)
        assert device.free_runs == 0
        awg.upload(SLOW, arm=True)
        awg.trigger()
        awg.arm()
        assert (device.volts_now, device.free_runs) == (0.0, 0)
        awg.trigger()
        assert len(device.plays) == 5


class CutWire:
    """A VISA resource on an instrument, dead from one of its reads and writes on."""

    def __init__(self, device, *, after):
        self.device = device
        self.left = after
        self.answers = []

    def _alive(self):
        if self.left == 0:
            raise OSError("cut")
        self.left -= 1

    def write_raw(self, message):
        self._alive()
        self.answers += self.device.execute(message.removesuffix(b"\n"))

    def read(self):
        self._alive()
        return self.answers.pop(0)

    def close(self):
        pass


@pytest.mark.slow  # every place of a cut
def test_a_link_cut_between_any_two_messages_leaves_nothing_that_runs_without_a_trigger():
    device = Awg()
    device._server.close()
    whole = CutWire(device, after=10_000)
    with ScpiAwg(ScpiLink(whole, name="wire")) as awg:
        arm_again_and_again(awg)
    messages = 10_000 - whole.left
    assert messages > 300
    for count in range(2, messages):
        device._reset()
        with (
            pytest.raises(LinkError, match="cut"),
            ScpiAwg(ScpiLink(CutWire(device, after=count), name="wire")) as awg,
        ):
            arm_again_and_again(awg)
        assert device.free_runs == 0
        if device.output:
            armed = (
                device.function,
                device.burst,
                device.burst_mode,
                device.cycles,
                device.source,
            )
            assert armed == ("ARB", True, "TRIG", 1, "EXT")


@pytest.mark.parametrize("ignored", ["FUNC ARB", "BURS:MODE TRIG", "BURS:NCYC 1", "TRIG:SOUR EXT"])
def test_an_instrument_that_would_repeat_the_code_is_not_switched_on(ignored):
    with Awg(Faults(ignore=ignored)) as device, ScpiAwg.open(device.resource) as awg:
        execute(device, "BURS:NCYC 7;MODE GAT")
        with pytest.raises(DeviceError, match="it is not armed"):
            awg.upload(PROGRAM, arm=True)
        assert "OUTP ON" not in device.messages
        assert device.free_runs == 0


def test_raskar_in_real_time_and_two_triggers():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        awg.upload(PROGRAM, arm=True)
        awg.trigger()
        awg.wait()
        awg.trigger()
        awg.wait()
        assert len(device.plays) == 2
        assert (
            device.plays[0] == device.plays[1] == expected(PROGRAM)
        )  # 5 kSa/s is exact in floating point too
        assert len(device.plays[0]) == 26
        assert device.volts_now == 0.0


def test_the_exported_script_does_the_same_line_by_line():
    with Awg() as device:
        lines = [
            line
            for line in EXPORTERS["scpi"].export(PROGRAM).splitlines()
            if not line.startswith("#")
        ]
        answers = execute(device, *lines)
        assert answers == ["1", '+0,"No error"']
        device.trigger_input()
        assert device.plays == [expected(PROGRAM)]


def test_play_arms_by_itself_and_leaves_the_output_as_it_was():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        awg.upload(PROGRAM)
        awg.play()
        assert same(device.plays[-1], expected(PROGRAM), PROGRAM)
        assert not device.output
        awg.arm()
        awg.play()
        assert device.output
        assert len(device.plays) == 2


def test_not_armed_still_playing_and_nothing_uploaded():
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        with pytest.raises(WrongStateError, match="upload before arm"):
            awg.arm()
        with pytest.raises(WrongStateError, match="arm before trigger"):
            awg.trigger()
        awg.upload(SLOW)
        with pytest.raises(WrongStateError, match="arm before trigger"):
            awg.trigger()
        awg.arm()
        awg.trigger()
        with pytest.raises(WrongStateError, match="still plays for"):
            awg.trigger()
        awg.abort()
        with pytest.raises(WrongStateError, match="arm before trigger"):
            awg.trigger()
        awg.arm()
        assert device.volts_now == 0.0  # the burst was stopped, not only hidden
        assert len(device.plays) == 1


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_leaving_by_an_exception_switches_the_output_off(kind):
    with Awg() as device:
        awg = ScpiAwg.open(device.resource)
        awg.upload(SLOW, arm=True)
        awg.trigger()
        assert device.output
        with pytest.raises(kind, match="mine") as caught, awg:
            raise kind("mine")
        assert not hasattr(caught.value, "__notes__")
        assert device.volts_now is None
        with pytest.raises(LinkError, match="is closed"):
            awg.link.ask("*IDN?")


def test_leaving_normally_keeps_an_armed_instrument_armed():
    with Awg() as device:
        with ScpiAwg.open(device.resource) as awg:
            awg.upload(PROGRAM, arm=True)
        assert device.rest_volts == 0.0
        device.trigger_input()
        assert len(device.plays) == 1


@pytest.mark.parametrize("ending", ["pass", "raise SystemExit(3)", "raise RuntimeError('oops')"])
def test_a_script_that_ends_without_closing_switches_the_output_off(ending):
    script = f"""
import sys
from hw.drivers.scpi import ScpiAwg
from hw.program import Program
awg = ScpiAwg.open(sys.argv[1])
awg.upload(Program("1" * 100, chip_ns=300_000_000), arm=True)
awg.trigger()
{ending}
"""
    with Awg() as device:
        command = [sys.executable, "-W", "error", "-c", script, device.resource]
        done = subprocess.run(
            command,
            cwd=Path(__file__).parents[3],
            timeout=60,
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Warning" not in done.stderr
        assert len(device.plays) == 1
        assert device.volts_now is None


def test_every_violation_is_told_and_nothing_is_sent():
    profile = DeviceProfile(name="led", max_on_ns=30, max_duty=0.4)
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        program = Program(RASKAR, chip_ns=15)
        assert len(awg.check(program, profile=profile)) == 3
        with pytest.raises(ValueError, match=r"at least 16 ns.*led: longest.*led: duty") as caught:
            awg.upload(program, profile=profile)
        with pytest.raises(ValueError, match="1000001 chips is too long"):
            awg.upload(Program("1" * 1_000_001, chip_ns=1000))
    assert "\n" not in str(caught.value)
    assert device.messages == ["*IDN?"]


def test_another_clock_is_another_code():
    for factor, right in ((1.01, False), (1 + 3e-6, False), (1 - 3e-7, True)):
        with Awg(Faults(rate_factor=factor)) as device, ScpiAwg.open(device.resource) as awg:
            if right:
                awg.upload(PROGRAM)
                continue
            with pytest.raises(
                DeviceError, match=r"would play at 5\d{3}[.\d]* Sa/s: chips of 200000 ns need 5000"
            ):
                awg.upload(PROGRAM, arm=True)
            assert not device.output


@pytest.mark.parametrize(
    "start",
    [
        name.split(" ")[0]
        for name in commands(PROGRAM)
        if not name.endswith("?") and name[0] not in "*D"
    ],
)
def test_a_refused_command_is_named_and_the_output_stays_off(start):
    faults = Faults(
        refuse={start if start not in ("OUTP", "FUNC:ARB", "FUNC") else f"{start} ": -222}
    )
    with Awg(faults) as device, ScpiAwg.open(device.resource) as awg:
        with pytest.raises(
            DeviceError, match=f'refuses {start}.*: -222,"Data out of range"'
        ) as caught:
            awg.upload(PROGRAM, arm=True)
        assert "\n" not in str(caught.value)
        assert not device.output
        with pytest.raises(WrongStateError):
            awg.arm()


def test_an_output_that_does_not_go_off_is_said():
    with Awg(Faults(refuse={"OUTP OFF": -221})) as device, ScpiAwg.open(device.resource) as awg:
        execute(device, "OUTP ON")
        with pytest.raises(LinkError, match=r"says '1' to OUTP\?") as caught:
            awg.upload(PROGRAM)
        assert len(caught.value.__notes__) == 1


@pytest.mark.parametrize(
    ("ignored", "asked"), [("OUTP ON", "OUTP?"), ("BURS:STAT ON", "BURS:STAT?")]
)
def test_what_is_not_armed_is_not_said_to_be_and_is_switched_off(ignored, asked):
    with Awg(Faults(ignore=ignored)) as device, ScpiAwg.open(device.resource) as awg:
        with pytest.raises(DeviceError) as caught:
            awg.upload(PROGRAM, arm=True)
        assert asked in str(caught.value)
        assert not device.output
        assert device.free_runs == 0
        with pytest.raises(WrongStateError):
            awg.trigger()


def test_refused_data_and_errors_of_others():
    with (
        Awg(Faults(refuse={"DATA:ARB SHUTTER": 786})) as device,
        ScpiAwg.open(device.resource) as awg,
        pytest.raises(DeviceError, match=r"refuses DATA:ARB SHUTTER,: \+786"),
    ):
        awg.upload(PROGRAM)
    with Awg() as device, ScpiAwg.open(device.resource) as awg:
        execute(device, "NONSENSE", "VOLT:HIGH twelve")
        assert len(device.errors) == 2
        assert awg.upload(PROGRAM).program == PROGRAM


@pytest.mark.parametrize("start", ["OUTP OFF", "DATA:ARB", "FUNC:ARB:SRAT?", "OUTP ON"])
def test_an_instrument_that_disappears_is_one_clear_line(start):
    with (
        Awg(Faults(hang_up_on=start)) as device,
        ScpiAwg.open(device.resource, timeout_s=0.6) as awg,
    ):
        with pytest.raises(LinkError, match=r"does not answer|is gone") as caught:
            awg.upload(PROGRAM, arm=True)
        assert "\n" not in str(caught.value)
        assert [note.partition(" did")[2] for note in caught.value.__notes__] == [
            " not confirm ABORT: the shutter may still be open"
        ]
        with pytest.raises(WrongStateError):
            awg.trigger()


def test_an_instrument_that_falls_silent_is_switched_off_all_the_same():
    with (
        Awg(Faults(deaf_on="TRIG")) as device,
        ScpiAwg.open(device.resource, timeout_s=0.8) as awg,
    ):
        awg.upload(SLOW, arm=True)
        with pytest.raises(LinkError, match=r"does not answer SYST:ERR\?") as caught:
            awg.trigger()
        assert len(caught.value.__notes__) == 1
        assert len(device.plays) == 1
        assert until(lambda: device.messages[-1] == "OUTP?")
        assert not device.output


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        (Faults(silent=True), r"does not answer \*IDN\?"),
        (
            Faults(identity="Keithley Instruments Inc.,MODEL 2400,123,C30"),
            "MODEL 2400.*33500-class generator",
        ),
        (Faults(identity="hello"), "is 'hello'"),
    ],
)
def test_something_that_is_no_generator_is_left_alone(faults, words):
    with Awg(faults) as device:
        with pytest.raises(PortError, match=words) as caught:
            ScpiAwg.open(device.resource, timeout_s=0.6)
        assert "\n" not in str(caught.value)
        assert device.messages == ["*IDN?"]


@pytest.mark.parametrize(
    "resource",
    ["nonsense", "", "USB0::0x0957::0x2C07::MY1::INSTR", "ASRL/dev/x::INSTR"],
)
def test_resources_that_cannot_be_opened(resource):
    with pytest.raises(PortError) as caught:
        ScpiAwg.open(resource, timeout_s=0.2)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(resource)


def test_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
    with pytest.raises(PortError, match=r"\*IDN\?|is gone|cannot be opened"):
        ScpiAwg.open(f"TCPIP::127.0.0.1::{number}::SOCKET", timeout_s=0.2)


def test_endless_errors_do_not_hang():
    class Grumbler:
        def write_raw(self, message):
            self.asked = message

        def read(self):
            return '-100,"and again"\r\n'

        def close(self):
            pass

    with pytest.raises(DeviceError, match="refuses OUTP ON: -100"):
        ScpiLink(Grumbler(), name="grumbler").do("OUTP ON")


def test_without_pyvisa_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(PortError, match=r"pip install coded-exposure\[visa\]"):
        ScpiAwg.open("TCPIP::127.0.0.1::5025::SOCKET")


def test_importing_the_drivers_imports_no_visa():
    assert (
        imported_with("hw.drivers.scpi, hw.drivers.pulse_pal", {"serial", "pyvisa", "numpy"})
        == set()
    )


def test_pyvisa_sim_another_implementation_understands_the_driver():
    backend = f"{SIMULATED}@sim"
    with ScpiAwg.open("TCPIP::awg::5025::SOCKET", backend=backend) as awg:
        assert awg.firmware == "33522B 3.05"
        for command in commands(PROGRAM):
            if not command.endswith("?") and not command.startswith("DATA:ARB"):
                awg.link.do(command)
        with pytest.raises(DeviceError, match="refuses OUTPUT PERHAPS"):
            awg.link.do("OUTPUT PERHAPS")
        assert awg.link.ask("FUNC:ARB:SRAT?") == "5000.0"
        awg.abort()
        assert awg.link.ask("OUTP?") == "OFF"
    with pytest.raises(PortError, match="33500-class generator"):
        ScpiAwg.open("TCPIP::meter::5025::SOCKET", backend=backend)


# ---- the fake instrument's own parser


def test_newlines_semicolons_and_commas_in_blocks_and_strings_end_nothing():
    block = b"#212;\n,\"'#9;\n,x;y"
    message = b"DATA:ARB X," + block + b"\nOUTP?\n"
    assert message_end(message) == len(message) - len(b"OUTP?\n")
    assert message_end(message[:20]) is None
    assert split_outside(b'A "x;y";B ' + block + b";C", b";") == [b'A "x;y"', b"B " + block, b"C"]


def test_headers_long_short_optional_and_relative():
    device = Awg()
    assert execute(
        device, "SOURce1:FUNCtion:ARBitrary:SRATe 1000;FILTer OFF;:sour:volt:high 3;low -1;*OPC?"
    ) == ["1"]
    assert (device.rate, device.filter, device.high, device.low) == (1000, "OFF", 3, -1)
    assert execute(device, "FUNCTI:ARB:SRAT 5", "SYST:ERR?", "SYSTEM:ERROR:NEXT?") == [
        '-113,"Undefined header"',
        '+0,"No error"',
    ]
    execute(
        device,
        "FUNC:ARB:SRAT 1e9",
        "OUTP",
        "OUTP 1,2",
        "OUTP maybe",
        "VOLT:HIGH five",
        "FUNC:ARB NONE",
    )
    assert device.errors == [-222, -109, -108, -224, -104, 785]
    assert device.rate == 62_500_000
    execute(device, *["X"] * 30)
    assert len(device.errors) == 20
    assert device.errors[-1] == -350
    device._server.close()


def test_blocks_byte_order_and_length():
    device = Awg()
    values = struct.pack("<8f", *[1, -1] * 4)
    execute(device, "FORM:BORD SWAP", b"DATA:ARB A,#232" + values)
    assert device.arbs["A"] == [1, -1] * 4
    execute(
        device,
        b"DATA:ARB B,#231" + values,
        b"DATA:ARB A,#232" + values,
        b"DATA:ARB C,#228" + values[:28],
    )
    execute(device, "FORM:BORD NORM", b"DATA:ARB D,#232" + struct.pack(">8f", *[0.5] * 8))
    execute(device, b"DATA:ARB E,#232" + struct.pack(">8f", *[1.5] * 8))
    assert device.errors == [-161, 786, -222, -222]
    assert device.arbs == {"A": [1, -1] * 4, "D": [0.5] * 8}
    device._server.close()


def test_levels_that_cross_give_way_and_a_load_of_50_ohm_doubles_the_voltage():
    device = Awg()
    execute(device, "VOLT:HIGH 8;LOW 6")
    execute(device, "VOLT:HIGH 5")
    assert device.errors == [-221]
    assert device.low == pytest.approx(4.999)
    execute(device, "DATA:ARB A,-1,1,-1,1,-1,1,-1,1;:FUNC:ARB A;:FUNC ARB;:VOLT:LOW 0;:OUTP ON")
    assert (device._volts(1), device.free_runs) == (10, 1)
    device._server.close()


def test_threads_are_gone():
    with Awg() as device:
        assert device._thread.is_alive()
    assert device._thread not in threading.enumerate()
