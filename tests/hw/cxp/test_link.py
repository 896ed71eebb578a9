import time

import pytest
from emulators.cxp_controller import HELLO, TRIG, CxpController, Faults
from emulators.scripted_port import ScriptedPort

from hw.cxp.link import Link, open_link
from hw.cxp.protocol import BINARY, TEXT, Op, State, Status, Stored, unpack_hello
from hw.drivers.cxp import Controller
from hw.errors import WrongStateError
from hw.port import LinkError, PortError, open_port
from hw.program import Program

FAST = {"timeout_s": 0.05, "attempts": 40}
PROGRAM = Program("101100000111", chip_ns=200_000)


HELLO_DATA = (
    bytes.fromhex("43585031 01 03 0004 f401 64000000 ffff0000 00000000 e803 204e0000 00")
    + b"cxp-avr 1"
)
BINARY_SCRIPT = (
    (
        "00 05 01 01 1f 3e 00",
        (
            "03 81 01 07 43 58 50 31 01 03 05 04 f4 01 64 01 01 03 ff ff 01 01 01 01 01 05 e8 03"
            " 20 4e 01 01 0c 63 78 70 2d 61 76 72 20 31 b0 ed 00"
        ),
    ),
    ("05 02 02 90 01 01 01 01 02 0c 05 b0 70 89 96 00", "03 82 02 07 e0 94 4c cb 01 b1 00"),
    ("05 07 03 fb b4 00", "03 87 03 02 01 01 02 02 01 05 01 87 d6 12 07 e0 94 4c cb f1 6b 00"),
    ("05 03 04 d8 08 00", "03 83 04 03 90 01 01 01 01 02 0c 05 b0 70 f4 eb 00"),
    ("05 07 05 3d d4 00", "03 87 05 02 01 01 02 02 01 05 01 87 d6 12 07 e0 94 4c cb bd 09 00"),
    ("07 04 06 88 13 f2 4c 00", "03 84 06 03 a0 81 00"),
    ("05 07 07 7f f4 00", "03 87 07 02 02 01 02 02 01 05 01 87 d6 12 07 e0 94 4c cb 5c cb 00"),
    ("05 05 08 f2 63 00", "03 85 08 03 9f 95 00"),
    ("05 07 09 b1 15 00", "03 87 09 03 03 05 02 02 01 05 01 87 d6 12 07 e0 94 4c cb 38 06 00"),
    ("05 06 0a e3 16 00", "03 86 0a 03 ad aa 00"),
    ("05 07 0b f3 35 00", "03 87 0b 02 01 01 02 02 01 05 01 87 d6 12 07 e0 94 4c cb e1 ec 00"),
)
TEXT_SCRIPT = (
    (b"\0".hex() + "05 01 01 1f 3e 00", ""),
    (
        b"\n:01011F3E\n".hex(),
        b":8101004358503101030004F40164000000FFFF000000000000E803204E0000006378702D6176722031B0ED\r\n".hex(),
    ),
    (b":02029001000000000C00B0708996\n".hex(), b":820200E0944CCB01B1\r\n".hex()),
    (b":0703FBB4\n".hex(), b":8703000100000200000187D61200E0944CCBF16B\r\n".hex()),
    (b":0304D808\n".hex(), b":8304009001000000000C00B070F4EB\r\n".hex()),
    (b":07053DD4\n".hex(), b":8705000100000200000187D61200E0944CCBBD09\r\n".hex()),
    (b":04068813F24C\n".hex(), b":840600A081\r\n".hex()),
    (b":07077FF4\n".hex(), b":8707000200000200000187D61200E0944CCB5CCB\r\n".hex()),
    (b":0508F263\n".hex(), b":8508009F95\r\n".hex()),
    (b":0709B115\n".hex(), b":8709000305000200000187D61200E0944CCB3806\r\n".hex()),
    (b":060AE316\n".hex(), b":860A00ADAA\r\n".hex()),
    (b":070BF335\n".hex(), b":870B000100000200000187D61200E0944CCBE1EC\r\n".hex()),
)


@pytest.mark.parametrize("script", [BINARY_SCRIPT, TEXT_SCRIPT], ids=["binary", "text"])
def test_transcript_of_every_op_byte_for_byte(script):
    port = ScriptedPort(*script)
    link = Link(port, name="script", attempts=1, timeout_s=0.02)
    with Controller(link, link.hello()) as controller:
        assert controller.announced == unpack_hello(HELLO_DATA)
        assert controller.load(PROGRAM) == Stored(PROGRAM.bits, 400, 0)
        assert controller.read() == Stored(PROGRAM.bits, 400, 0)
        assert controller.arm(lease_ms=5000).state is State.ARMED
        controller.trigger()
        assert controller.status() == Status(State.PLAY, 5, 2, 0, 1, 1_234_567, 0xCB4C94E0)
        assert controller.abort().state is State.LOADED
    assert port.exchanges == []
    assert port.waiting == b""
    assert port.closed
    assert (link.retries, link.bad_frames) == (0, 0)


def test_a_device_of_either_framing_is_found():
    for text in (False, True):
        with (
            CxpController(text=text) as device,
            Controller.open(device.port, **FAST) as controller,
        ):
            assert controller.link.framing is (TEXT if text else BINARY)
            assert controller.upload(PROGRAM).read_back
            assert device.bits == PROGRAM.bits


def test_retry_sends_the_same_frame_after_ending_half_a_frame():
    port = ScriptedPort(
        ("05 05 01 db f2 00", ""), ("00 05 05 01 db f2 00", "03 85 01 03 07 2f 00")
    )
    with Link(port, name="script", timeout_s=0.02, attempts=2) as link:
        assert link.request(Op.TRIG) == b""
    assert port.exchanges == []


def test_a_reply_is_waited_for_until_the_timeout():
    class SlowPort(ScriptedPort):
        """A port with nothing to read for some reads after a request."""

        reads = 0

        def read(self, size):
            self.reads += 1
            return super().read(size) if self.reads > 5 else b""

    port = SlowPort(("05 05 01 db f2 00", "03 85 01 03 07 2f 00"))
    with Link(port, name="script", timeout_s=5.0, attempts=1) as link:
        assert link.request(Op.TRIG) == b""
        assert link.retries == 0
    silent = ScriptedPort(("05 05 01 db f2 00", ""))
    with (
        Link(silent, name="script", timeout_s=0.02, attempts=1) as link,
        pytest.raises(LinkError),
    ):
        link.request(Op.TRIG)


def test_old_foreign_and_broken_replies_are_ignored():
    # In order: another seq, another op, a wrong CRC, noise, a request (our echo), then the right
    # reply.
    noise = (
        "03 85 05 03 c3 e3 00 06 86 01 04 d3 36 00 03 85 01 03 07 28 00 ff 00 05 05 01 db f2 00"
    )
    port = ScriptedPort(("05 05 01 db f2 00", noise + "03 85 01 03 07 2f 00"))
    with Link(port, name="script", attempts=1) as link:
        assert link.request(Op.TRIG) == b""
    assert link.bad_frames == 3


def test_sequence_numbers_wrap():
    with CxpController() as device, open_link(device.port, **FAST)[0] as link:
        for _ in range(520):
            link.request(Op.STATUS)
    assert len(device.ops) == 521
    assert device.pending == b""


def test_lost_first_bytes_are_retried():
    with CxpController(
        Faults(deaf_s=0.4, boot_noise=b"\x00garbage\xff\x80 boot v1\r\n")
    ) as device:
        link, hello = open_link(device.port, timeout_s=0.05)
        link.close()
    assert hello == unpack_hello(HELLO_DATA)
    assert link.retries >= 1


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        (Faults(silent=True), "silent for 0.2 s"),
        (Faults(babble=b"ERROR\r\n"), "no CXP1 reply: wrong baud"),
        (Faults(babble=b"\x00\xff\x00" * 50), "no CXP1 reply: wrong baud"),
        (Faults(magic=b"HARP"), "not a CXP1 shutter controller: .*HARP"),
        (Faults(version=9), "version 9"),
        (Faults(bad_crc_replies=10**6), "no CXP1 reply"),
    ],
)
def test_a_port_that_is_not_ours(faults, words):
    with CxpController(faults) as device:
        with pytest.raises(PortError, match=words) as caught:
            open_link(device.port, timeout_s=0.05, hello_s=0.2)
        assert str(caught.value).startswith(device.port)
        assert "\n" not in str(caught.value)
        open_port(device.port).close()  # it was let go


def test_missing_wrong_and_busy_ports(tmp_path):
    plain = tmp_path / "plain.txt"
    plain.write_text("not a port")
    for name, words in [
        (str(tmp_path / "ttyNONE"), "there is no such port"),
        (str(plain), "cannot be opened"),
        (str(tmp_path), "cannot be opened"),
        ("", "name a serial port"),
        (None, "name a serial port"),
        ("a\0b", "cannot be opened"),
    ]:
        with pytest.raises(PortError, match=words) as caught:
            open_port(name)
        assert "\n" not in str(caught.value)
    with CxpController() as device:
        with (
            open_link(device.port, **FAST)[0],
            pytest.raises(PortError, match="another program has it open"),
        ):
            open_port(device.port)
        open_port(device.port).close()


def test_lost_reply_of_a_trigger_never_plays_twice():
    with (
        CxpController(Faults(lost_replies={TRIG: 3})) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        controller.upload(PROGRAM, arm=True)
        controller.trigger()
        assert controller.wait(timeout_s=5).runs == 1
    assert len(device.plays) == 1
    assert device.repeats >= 3


@pytest.mark.parametrize(
    "faults",
    [Faults(bad_crc_replies=3), Faults(wrong_seq_replies=3), Faults(lost_replies={HELLO: 2})],
)
def test_bad_replies_are_waited_out(faults):
    with CxpController(faults) as device, Controller.open(device.port, **FAST) as controller:
        assert controller.upload(PROGRAM).trust == "A"
        assert controller.link.retries >= 2


def test_silence_midway_is_a_link_error():
    with CxpController() as device:
        link, _ = open_link(device.port, timeout_s=0.02, attempts=3)
        with link:
            device.mute = True
            with pytest.raises(LinkError, match="does not answer STATUS, asked 3 times") as caught:
                link.request(Op.STATUS)
    assert "\n" not in str(caught.value)


def test_closed_link_says_so_and_closes_twice():
    with CxpController() as device:
        link, _ = open_link(device.port, **FAST)
        link.close()
        link.close()
        assert not link.abort()
        with pytest.raises(LinkError, match="is closed"):
            link.request(Op.STATUS)


def test_refused_request_changes_nothing_and_is_not_repeated():
    with CxpController() as device, open_link(device.port, **FAST)[0] as link:
        with pytest.raises(WrongStateError, match="refuses TRIG"):
            link.request(Op.TRIG)
        assert device.ops == [HELLO, TRIG]
        assert device.plays == []


@pytest.mark.parametrize("last", [Op.STATUS, Op.ABORT])
def test_an_error_aborts_what_is_loaded_unless_it_was_aborted(last):
    with CxpController() as device:
        controller = Controller.open(device.port, **FAST)
        controller.upload(PROGRAM)
        controller.link.request(last)
        with pytest.raises(ZeroDivisionError), controller.link:
            raise ZeroDivisionError
        assert device.ops.count(Op.ABORT) == 1


def test_endless_garbage_does_not_hang():
    class Firehose(ScriptedPort):
        in_waiting = 4096

        def read(self, size):
            return b"\xa5" * size

        def write(self, data):
            pass

    start = time.monotonic()
    with Link(Firehose(), name="hose", timeout_s=0.05, attempts=2) as link:
        with pytest.raises(LinkError, match="does not answer"):
            link.request(Op.STATUS)
        assert len(link._rest) <= 20_000
    assert time.monotonic() - start < 60
