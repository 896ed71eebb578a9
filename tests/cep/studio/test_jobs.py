"""Jobs as a page sees them: real processes, one at a time, that end with their page."""

import asyncio
import os
import signal
import sys

import numpy as np
import pytest
from emulators.tools import require_simavr
from killed_parents import outliving

import cep
from cep.files.images import read_image
from cep.files.shot_files import read_shot, record_beside
from cep.photographs.scenes import NAMES, photographs
from cep.studio import jobs as module
from cep.studio.jobs import BusyError, Jobs
from cep.studio.work import lost_interrupts
from hw.cxp.protocol import State
from hw.drivers.cxp import Controller
from hw.emulation.uno import EmulatedUno

PAGE = "a" * 16
OTHER = "b" * 16


@pytest.fixture
def setting():
    return {
        "motion": {"kind": "straight", "length": 16, "angle": 0},
        "bits": "1101000111010110",
        "exposure": "20ms",
        "camera": "video-8bit",
        "photons": 2000,
    }


def running(scenario):
    """Run a scenario with jobs of its own in an event loop."""

    async def whole():
        jobs = Jobs()
        try:
            return await asyncio.wait_for(scenario(jobs), 120)
        finally:
            jobs.close()

    return asyncio.run(whole())


async def until(queue, wanted):
    while True:
        job = await queue.get()
        if job is not None and wanted(job):
            return job


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.slow  # a process that loads the library, and a search
def test_a_search_is_that_of_the_front_door(setting):
    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(PAGE, "search", {"setting": setting, "steps": 3000, "seed": 5})
        return await until(queue, lambda job: job.state != "running")

    done = running(scenario)
    assert done.state == "done", done.error
    light = cep.Camera.load("video-8bit").at(2000)
    problem = cep.SearchProblem.along(
        cep.Trajectory.straight(16.0), chips=16, exposure_s=0.02, camera=light, objective="mse"
    )
    meant = cep.optimize(problem, steps=3000, seed=5)
    assert done.result["bits"] == meant.code.bits
    assert done.result["sentence"] == meant.verdict.sentence
    assert done.best["bits"].count("1") > 0


@pytest.mark.slow  # a process that loads the library
def test_one_job_at_a_time_and_an_automatic_one_gives_way(setting):
    async def scenario(jobs):
        jobs.listen(PAGE)
        automatic = jobs.start(PAGE, "advise", {"setting": setting})
        first = jobs._process.pid
        search = jobs.start(PAGE, "search", {"setting": setting, "steps": 10**9})
        assert automatic.state == "stopped"
        assert gone(first)
        for page, words in ((PAGE, "this page"), (OTHER, "another page")):
            with pytest.raises(BusyError, match=words):
                jobs.start(page, "search", {"setting": setting})
        assert jobs.current(OTHER) is None
        return search, jobs._process.pid

    search, pid = running(scenario)
    assert search.state == "stopped"  # with the server
    assert gone(pid)


@pytest.mark.slow  # a process that loads the library
def test_a_search_that_is_stopped_keeps_its_best(setting):
    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(
            PAGE, "search", {"setting": {**setting, "bits": setting["bits"] * 3}, "steps": 10**9}
        )
        seen = await until(queue, lambda job: job.best.get("bits") and job.share > 0)
        jobs.stop(PAGE)
        return seen, await until(queue, lambda job: job.state != "running")

    _, done = running(scenario)
    assert done.state == "done"
    assert done.result["stopped"] == "interrupted"
    assert len(done.result["bits"]) == 48


def test_a_stop_that_comes_in_a_finalizer_is_not_lost(monkeypatch):
    class Finalized:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):  # Python looks for signals between instructions
                pass

    monkeypatch.setattr(sys, "unraisablehook", sys.__unraisablehook__)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        stop_if_asked = lost_interrupts()
        stop_if_asked()
        Finalized()
        with pytest.raises(KeyboardInterrupt):
            stop_if_asked()
        stop_if_asked()  # one stop is one interrupt
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.slow  # a process that loads the library
def test_a_job_dies_with_its_page_but_not_when_it_is_loaded_again(setting, monkeypatch):
    monkeypatch.setattr(module, "_GRACE_S", 0.2)

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        job = jobs.start(PAGE, "search", {"setting": setting, "steps": 10**9})
        pid = jobs._process.pid
        jobs.leave(PAGE, queue)
        again = jobs.listen(PAGE)
        await asyncio.sleep(0.5)
        assert job.state == "running"
        jobs.leave(PAGE, again)
        await asyncio.sleep(0.5)
        return job, pid

    job, pid = running(scenario)
    assert job.state == "stopped"
    assert gone(pid)


@pytest.mark.slow  # a process that loads the library
def test_a_job_whose_page_never_listened_ends(setting, monkeypatch):
    monkeypatch.setattr(module, "_GRACE_S", 0.2)

    async def scenario(jobs):
        order = {"setting": setting, "steps": 10**9}
        job = jobs.start(PAGE, "search", order)
        pid = jobs._process.pid
        while job.state == "running":
            await asyncio.sleep(0.05)
        ended = gone(pid)
        later = jobs.start(PAGE, "search", order)  # the page listens in time
        jobs.listen(PAGE)
        await asyncio.sleep(0.5)
        return job, ended, later.state

    job, ended, later = running(scenario)
    assert (job.state, ended, later) == ("stopped", True, "running")


@pytest.mark.slow  # a process that loads the library
def test_a_stop_that_is_not_followed_ends_the_job(setting, monkeypatch):
    monkeypatch.setattr(module, "_LAST_S", 0.3)

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        job = jobs.start(PAGE, "search", {"setting": setting, "steps": 10**9})
        pid = jobs._process.pid
        os.kill(pid, signal.SIGSTOP)  # as work that never comes back to Python
        jobs.stop(PAGE)
        jobs.stop(PAGE)  # an impatient hand ends nothing earlier
        assert job.state == "running"
        await until(queue, lambda job: job.state != "running")
        return job, pid

    job, pid = running(scenario)
    assert job.state == "stopped"
    assert gone(pid)


def test_streams_left_open_are_counted(monkeypatch):
    monkeypatch.setattr(module, "_MOST_LISTENERS", 2)

    async def scenario(jobs):
        jobs.listen(PAGE)
        left = jobs.listen(OTHER)
        with pytest.raises(BusyError, match="too many pages listen"):
            jobs.listen(PAGE)
        jobs.leave(OTHER, left)
        return jobs.listen(PAGE)

    assert running(scenario).get_nowait() is None


@pytest.mark.slow  # a process that loads the library
def test_wrong_work_is_one_line_and_no_crash(tmp_path):
    bad = tmp_path / "0123.png"
    bad.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(PAGE, "calibrate", {"path": str(bad)})
        return await until(queue, lambda job: job.state != "running")

    failed = running(scenario)
    assert failed.state == "failed"
    assert failed.error["field"] == "photo"
    assert str(tmp_path) not in failed.error["message"]


@pytest.mark.slow  # a process that loads the library, and an emulated board
def test_a_code_is_played_on_the_emulated_controller(setting):
    require_simavr()

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(
            PAGE, "play", {"setting": {**setting, "exposure": "20001us"}, "port": "emulated"}
        )
        return await until(queue, lambda job: job.state != "running")

    done = running(scenario)
    assert done.state == "done", done.error
    edges = done.result["edges_ns"]
    assert [level for _, level in edges] == [1, 0] * 5  # 1101000111010110 opens five times
    assert done.result["trust"] == "A"
    assert "whole ticks of 500 ns" in done.result["warnings"][0]
    chips = [0, 2, 3, 4, 7, 10, 11, 12, 13, 15]
    assert [time_ns for time_ns, _ in edges] == pytest.approx(
        [1_250_000 * chip for chip in chips], abs=200
    )


def shot_order(setting, folder, **changes):
    order = {"camera": "twin:scene=cat", "port": "emulated", "release": "", "photo": "key"}
    return {"setting": setting, **order, "path": str(folder / "key.tif"), **changes}


@pytest.mark.slow  # a process that loads the library, and an emulated board
def test_a_photo_is_taken_shown_and_restored(setting, tmp_path):
    require_simavr()

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(PAGE, "shoot", shot_order(setting, tmp_path))
        shown = await until(queue, lambda job: job.best or job.state != "running")
        assert shown.state == "running", shown.error
        assert (tmp_path / "key_preview.jpg").exists()  # before it is restored
        return await until(queue, lambda job: job.state != "running")

    done = running(scenario)
    assert done.state == "done", done.error
    assert done.result["counts"]
    assert "played once" in done.result["verdict"]
    assert sum(done.result["histogram"]) == done.result["width"] * done.result["height"]
    record = record_beside(tmp_path / "key.tif")
    assert record.code.bits == setting["bits"]
    assert record.trajectory.length_px == pytest.approx(16)
    # it is the photo that was restored: far nearer to the scene than the blurred one
    sharp = read_image(tmp_path / "key_sharp.png")
    scene = photographs()[NAMES.index("cat")]
    rows, columns = sharp.shape[:2]
    top, left = ((scene.shape[axis] - sharp.shape[axis]) // 2 for axis in (0, 1))
    middle = scene[top : top + rows, left : left + columns]
    blurred = read_shot(tmp_path / "key.tif", record).pixels / record.code.duty
    errors = [np.abs(photo - middle)[20:-20, 20:-20].mean() for photo in (sharp, blurred)]
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.slow  # a process that loads the library, and an emulated board
def test_a_cancelled_photo_closes_the_shutter_and_frees_the_camera(setting, tmp_path):
    require_simavr()
    with EmulatedUno() as uno:
        waiting = shot_order(
            setting, tmp_path, camera=f"folder:{tmp_path}", port=uno.port, release="external"
        )

        async def scenario(jobs):
            queue = jobs.listen(PAGE)
            jobs.start(PAGE, "shoot", waiting)
            await until(queue, lambda job: job.note.startswith("waiting") or job.error)
            await asyncio.sleep(0.5)  # until it is armed
            jobs.stop(PAGE)
            return (await until(queue, lambda job: job.state != "running")).state

        assert running(scenario) == "stopped"
        uno.trigger()
        with Controller.open(uno.port) as controller:  # the port is free again
            assert controller.status().state in (State.LOADED, State.DONE)
        assert uno.edges() == ()


@pytest.mark.slow  # a process that loads the library
@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"camera": "leica:"}, "shot_camera", "kind 'leica' is not known; known are"),
        ({"camera": "twin:scene=no.png"}, "shot_camera", "is no file, and none of"),
        ({"camera": "folder:.", "port": "/dev/no"}, "shot_port", "/dev/no cannot be opened"),
    ],
)
def test_a_photo_that_cannot_be_taken_is_one_line_at_its_field(
    setting, tmp_path, changes, field, words
):
    require_simavr()

    async def scenario(jobs):
        queue = jobs.listen(PAGE)
        jobs.start(PAGE, "shoot", shot_order(setting, tmp_path, **changes))
        return await until(queue, lambda job: job.state != "running")

    failed = running(scenario)
    assert failed.state == "failed"
    assert failed.error["field"] == field
    assert words in failed.error["message"]
    assert list(tmp_path.iterdir()) == []


SERVER = """
import asyncio
from pathlib import Path
import cep.studio.jobs as module
from cep.studio import work

async def serve():
    jobs = module.Jobs()
    jobs.warm()
    queue = jobs.listen("page")
    jobs.start("page", "search", {{"setting": {setting!r}, "steps": 10**9}})
    while True:
        job = await queue.get()
        if job is not None and job.best:
            Path({busy!r}).touch()

asyncio.run(serve())
"""


@pytest.mark.slow(reason="a server, and a process that loads the library")
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="/proc tells which processes live"
)
def test_a_job_ends_with_a_server_that_is_killed(tmp_path, setting):
    busy = tmp_path / "busy"
    assert outliving(SERVER.format(setting=setting, busy=str(busy)), busy=busy, least=2) == []
