"""What every driver does of an upload: arms where asked or where a play needs it, and says so."""

import pytest

from hw.device import load_profile
from hw.drivers.driver import Driver, Trust, UploadReport
from hw.program import Program

PROGRAM = Program("1011", chip_ns=1_000_000)


class RecordingDriver(Driver):
    """A driver that notes what it is asked to do."""

    def __init__(self) -> None:
        self.calls = []

    @classmethod
    def open(cls, _port):
        return cls()

    def check(self, _program, *, profile=None):
        return () if profile is None else ("too fast",)

    def _upload(self, program, *, profile, arm, lease_ms, clock_ppm):
        self.calls.append("upload armed" if arm else "upload")
        self.profile = profile
        return UploadReport(
            port="p",
            program=program,
            trust=Trust.B,
            read_back=False,
            firmware="f",
            armed=arm,
            lease_ms=lease_ms if arm else None,
            retries=0,
            seconds=0.0,
            clock_ppm=clock_ppm,
        )

    def arm(self):
        self.calls.append("arm")

    def play(self):
        self.calls.append("play")

    def status(self):
        return None

    def abort(self):
        self.calls.append("abort")

    def __exit__(self, *_):
        self.abort()


class ArmingDriver(RecordingDriver):
    """One whose device plays only what is armed."""

    armed_to_play = True


@pytest.mark.parametrize(
    ("kind", "asked", "calls", "armed"),
    [
        (RecordingDriver, {}, ["upload"], False),
        (RecordingDriver, {"arm": True}, ["upload armed"], True),
        (RecordingDriver, {"play": True}, ["upload", "play"], False),
        (RecordingDriver, {"arm": True, "play": True}, ["upload armed", "play"], True),
        (ArmingDriver, {}, ["upload"], False),
        (ArmingDriver, {"arm": True}, ["upload armed"], True),
        (ArmingDriver, {"play": True}, ["upload armed", "play"], False),
        (ArmingDriver, {"arm": True, "play": True}, ["upload armed", "play"], False),
    ],
)
def test_a_device_is_armed_where_it_is_asked_or_a_play_needs_it(kind, asked, calls, armed):
    driver = kind.open("p")
    report = driver.upload(PROGRAM, lease_ms=500, clock_ppm=3.0, **asked)
    assert driver.calls == calls
    assert report.armed is armed
    assert report.lease_ms == (500 if armed else None)
    assert (report.program, report.clock_ppm) == (PROGRAM, 3.0)


def test_a_profile_may_be_named():
    driver = RecordingDriver.open("p")
    for profile in ("flc", load_profile("flc")):
        driver.upload(PROGRAM, profile=profile)
        assert driver.profile == load_profile("flc")
    driver.upload(PROGRAM)
    assert driver.profile is None
