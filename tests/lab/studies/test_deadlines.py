"""Studies end where what they wait for does not come."""

import numpy as np
import pytest
from emulators.tools import require_simavr

from lab.studies import hardware, shoot_faults
from lab.studies.studio import until


def test_what_does_not_come_ends_the_studio_s_study():
    until(iter([False, False, True]).__next__, "the page", pause_s=0)
    with pytest.raises(SystemExit, match="the page within 0 s"):
        until(lambda: False, "the page", limit_s=0, pause_s=0)


def test_a_trigger_that_is_not_obeyed_ends_the_study(monkeypatch):
    require_simavr()
    monkeypatch.setattr(hardware, "_PATIENCE_S", 0.0)
    monkeypatch.setattr(hardware.EmulatedUno, "trigger", lambda _uno: None)
    with pytest.raises(SystemExit, match="was not obeyed"):
        hardware.trigger_latencies(1)


def test_a_host_that_never_plays_does_not_pass(tmp_path, monkeypatch):
    require_simavr()
    monkeypatch.setattr(shoot_faults, "CODE", "no code")
    outcome = shoot_faults.run_killed("kill -9", tmp_path, np.random.default_rng(0))
    assert not outcome.passed
    assert outcome.lines == ("the host never played; its exit code: 2",)
