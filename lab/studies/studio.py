"""The studio in a headless Chromium: time to paint and to show a change, memory, a large photo and
requests that it must refuse.

Times are from the hand's event until strip, MTFs, figures and the simulated photo of this state
are on the page. The memory is the proportional share (PSS) of the server and all its processes:
pages that they share count once. It needs Chromium and Playwright, as `.ci/tools` and the extra
`browser` install them.

    python -m lab.studies.studio [--changes 60] [--requests 300]
"""

from __future__ import annotations

import http.client
import json
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from lab.studies.inputs import study_parser

HOSTILE_REQUESTS = Path(__file__).parents[2] / "tests" / "helpers" / "hostile_requests.py"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
STATES = {
    "straight 40 px, 52 chips": "motion=straight:40:0",
    "straight 40 px at 30 degrees, 52 chips": "motion=straight:40:30",
    "hand shake, 52 chips": "motion=example:shake",
    "random walk of 60 px, 52 chips": "motion=example:walk",
    "straight 40 px, 128 chips": "motion=straight:40:0&code=" + "1011001110001011" * 8,
}
FLIPS = """async (count) => {
  const body = document.body.dataset, times = [];
  const chips = document.querySelectorAll("#strip button");
  const settled = () => body.picture === body.asked && body.photo === body.asked;
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  for (let i = 0; i < count; i++) {
    const begun = performance.now();
    chips[(7 * i) % chips.length].click();
    while (!settled()) {
      if (performance.now() - begun > 60000) throw new Error("not settled within 60 s");
      await frame();
    }
    await frame();
    times.push(performance.now() - begun);
    await new Promise((done) => setTimeout(done, 60));
  }
  return times;
}"""
DRAGS = """async (count) => {
  const body = document.body.dataset, range = document.getElementById("length-range"), times = [];
  const settled = () => body.picture === body.asked && body.photo === body.asked;
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  for (let i = 0; i < count; i++) {
    const begun = performance.now();
    range.value = 20 + (i % 40);
    range.dispatchEvent(new Event("input"));
    while (!settled()) {
      if (performance.now() - begun > 60000) throw new Error("not settled within 60 s");
      await frame();
    }
    await frame();
    times.push(performance.now() - begun);
    await new Promise((done) => setTimeout(done, 60));
  }
  return times;
}"""


SEARCH = """async () => {
  const motion = { kind: "example", name: "shake" }, bits = "10".repeat(26);
  const setting = { motion, bits, exposure: "1/30", camera: "aptina-mt9m031-8bit" };
  const page = JSON.parse(sessionStorage.getItem("studio-page"));
  const order = { page, kind: "search", steps: 1e9, setting };
  const headers = { "Content-Type": "application/json" };
  await fetch("/api/job", { method: "POST", headers, body: JSON.stringify(order) });
}"""


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--changes", type=int, default=60)
    parser.add_argument("--requests", type=int, default=300)
    options = parser.parse_args()
    chromium = next(filter(None, map(shutil.which, BROWSERS)), None)
    if chromium is None:
        parser.error(f"no browser is on the PATH: {', '.join(BROWSERS)}")
    print(f"{os.cpu_count()} cores; load before {os.getloadavg()[0]:.1f}: the machine is shared")
    with running_studio() as (netloc, cookie, process):
        peak = Peak(process)
        try:
            in_browser(chromium, netloc, cookie, options.changes, peak)
            refused(netloc, cookie, options.requests)
        finally:
            peak.stop()


@contextmanager
def running_studio() -> Iterator[tuple[str, str, int]]:
    """Start a studio; its host and port, a cookie of its page, and its process. It is ended."""
    command = [
        sys.executable,
        "-c",
        "from cep.commands.main import run; run()",
        "studio",
        "--no-browser",
        "--json",
    ]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        output = ""
        for line in server.stdout:
            output += line
            if output.rstrip().endswith("}"):
                break
        else:
            raise SystemExit(f"error: the studio ended, with exit code {server.wait()}")
        home = urlsplit(json.loads(output)["address"])
        # the key works once
        _, headers = send(home.netloc, "GET", f"/?{home.query}", {}, [])
        yield home.netloc, headers["set-cookie"].split(";")[0], server.pid
    finally:
        server.send_signal(signal.SIGINT)
        print(f"exit code {server.wait(20)}; load after {os.getloadavg()[0]:.1f}")


def in_browser(chromium: str, netloc: str, cookie: str, changes: int, peak: Peak) -> None:
    from playwright.sync_api import sync_playwright

    address = f"http://{netloc}/"
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": 1440, "height": 1000})
        name, _, value = cookie.partition("=")
        context.add_cookies([{"name": name, "value": value, "url": address}])
        page = context.new_page()
        page.goto(address)
        wait(page)
        started = time.perf_counter()
        page.goto(address)
        paint = page.evaluate(
            "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
        )
        wait(page)
        elapsed_s = time.perf_counter() - started
        print(
            f"page: first paint {paint or float('nan'):.0f} ms, all of its first state"
            f" {1000 * elapsed_s:.0f} ms"
        )
        for name, state in STATES.items():
            page.evaluate("state => { location.hash = state; }", state)
            wait(page)
            row(f"flip a chip: {name}", page, FLIPS, changes, peak.pid)
        page.evaluate("() => { location.hash = 'motion=straight:40:0'; }")
        wait(page)
        row("drag the length of a straight motion", page, DRAGS, changes, peak.pid)
        page.evaluate("() => { location.hash = 'motion=example:shake'; }")
        wait(page)
        page.evaluate(SEARCH)
        time.sleep(4)
        second_page = context.new_page()
        second_page.goto(f"{address}#motion=example:shake")
        wait(second_page)
        row(
            "flip a chip on a second page while the first one searches",
            second_page,
            FLIPS,
            changes,
            peak.pid,
        )
        running = page.locator("#stop").is_visible()
        print(
            f"the search was {'still running' if running else 'over already'}; memory so far"
            f" {peak.now():.0f} MB"
        )
        if running:
            page.locator("#stop").click()
        until(page.locator("#search").is_visible, "the search did not stop")
        print(f"memory at most {peak.most:.0f} MB, pictures and searches")
        large_photo(page, peak)
        browser.close()


def large_photo(page: Any, peak: Peak) -> None:
    from skimage import data

    from cep.files.images import encode_image
    from motdiff.photo_values import to_linear
    from motdiff.simulate import blur_valid
    from motdiff.trajectory import Trajectory

    path = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    blurred = blur_valid(to_linear(data.astronaut() / 255), path.psf(33))[:480, :480]
    photo = np.clip(np.tile(blurred, (9, 12, 1))[:4000, :5760], 0, 1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "large.jpg"
        file.write_bytes(encode_image(photo, ".jpg"))
        peak.reset()
        started = time.perf_counter()
        page.locator("#photo-file").set_input_files(file)

        def has_motion() -> bool:
            failed = page.locator(".error[data-for=photo]").inner_text()
            assert not failed, failed
            return "motion=path:" in page.url

        until(has_motion, "the photo's motion did not come", pause_s=0.1)
        megapixels = photo.shape[0] * photo.shape[1] / 1e6
        seconds = time.perf_counter() - started
        print(
            f"photo of {megapixels:.1f} MP: motion after {seconds:.1f} s, memory at most"
            f" {peak.most:.0f} MB"
        )


def refused(netloc: str, cookie: str, count: int) -> None:
    """Send hostile requests; each must be answered with 4xx, and nothing may be left behind."""
    hostile = runpy.run_path(str(HOSTILE_REQUESTS))["hostile"]
    before = left()
    rng = np.random.default_rng(1)
    codes: dict[int | None, int] = {}
    for number in range(count):
        method, path, changed, chunks = hostile(rng)
        headers = {"host": netloc, "origin": f"http://{netloc}", "cookie": cookie}
        headers |= {name: value for name, value in changed.items() if value is not None}
        for name in [name for name, value in changed.items() if value is None]:
            headers.pop(name)
        half = method == "POST" and number % 5 == 0
        status = send(netloc, method, path, headers, chunks, half=half)[0]
        codes[status] = codes.get(status, 0) + 1
    alive = send(netloc, "GET", "/", {"host": netloc, "cookie": cookie}, [])[0]
    wrong = {status for status in codes if status is not None and not 400 <= status < 500}
    print(
        f"{count} hostile requests: {dict(sorted(codes.items(), key=str))} (None: half an upload,"
        " broken off)"
    )
    print(
        f"answers other than 4xx: {wrong or 'none'}; files left: {left() - before or 'none'}; the"
        f" page then: {alive}"
    )


def send(
    netloc: str,
    method: str,
    path: str,
    headers: dict[str, str],
    chunks: list[bytes],
    *,
    half: bool = False,
) -> tuple[int | None, dict[str, str]]:
    connection = http.client.HTTPConnection(netloc, timeout=20)
    try:
        connection.putrequest(
            method,
            re.sub(r"[^!-~]", "x", path),
            skip_host="host" in headers,
            skip_accept_encoding=True,
        )
        for name, value in headers.items():
            connection.putheader(name, value.encode("latin-1", "replace"))
        length = sum(map(len, chunks))
        if chunks:
            connection.putheader("content-length", str(length + (5_000 if half else 0)))
        connection.endheaders()
        for chunk in chunks:
            connection.send(chunk)
        if half and chunks:
            return None, {}
        answer = connection.getresponse()
        answer.read()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}
    except (BrokenPipeError, ConnectionResetError):  # refused before all of it was sent
        return 413, {}
    finally:
        connection.close()


def left() -> set[str]:
    """Files in the folders of running studios."""
    folders = Path(tempfile.gettempdir()).glob("cep-studio-*")
    return {str(file) for folder in folders for file in folder.rglob("*")}


def until(
    condition: Callable[[], bool], failure: str, *, limit_s: float = 120.0, pause_s: float = 0.2
) -> None:
    """Wait for a condition; end the study where it does not come true."""
    deadline_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise SystemExit(f"error: {failure} within {limit_s:g} s")
        time.sleep(pause_s)


def wait(page: Any) -> None:
    names = (
        "['picture', 'photo', 'verdict'].every((one) => document.body.dataset[one] ==="
        " document.body.dataset.asked)"
    )
    settled = f"document.body.dataset.asked !== undefined && {names}"
    until(lambda: page.evaluate(settled), "the page did not settle", pause_s=0.01)


def row(name: str, page: Any, script: str, changes: int, server: int) -> None:
    """Print the times of changes, and the processor time that each took: the server's, and the
    browser's.
    """
    before = cpu_s(server)
    median, high = np.percentile(page.evaluate(script, changes), [50, 95])
    took = [
        1000 * (after - start_s) / changes
        for start_s, after in zip(before, cpu_s(server), strict=True)
    ]
    print(
        f"{name}: median {median:.0f} ms, p95 {high:.0f} ms; processor {took[0]:.0f} ms in the"
        f" server, {took[1]:.0f} ms in the browser; {changes} changes, load"
        f" {os.getloadavg()[0]:.1f}",
        flush=True,
    )


def cpu_s(server: int) -> tuple[float, float]:
    """Processor seconds of the server itself, without its jobs, and of the browser with all its
    processes.
    """

    def of(pid: int) -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    ours = family(os.getpid())
    servers = set(family(server))
    return of(server), sum(of(pid) for pid in ours if pid not in servers and pid != os.getpid())


def family(root: int) -> list[int]:
    """List a process and all that it started."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int(
                (folder / "stat").read_text().rpartition(")")[2].split()[1]
            )
        except (OSError, ValueError):
            continue
    pids = [root]
    for pid in pids:
        pids += [child for child, parent in parents.items() if parent == pid]
    return pids


class Peak:
    """Largest proportional set size of a process and those that it started, MB."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.most = 0.0
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def now(self) -> float:
        """Return what it is now."""
        return sum(self._pss(pid) for pid in family(self.pid))

    def reset(self) -> None:
        """Begin anew."""
        self.most = 0.0

    def stop(self) -> None:
        """Stop watching."""
        self._over.set()

    def _watch(self) -> None:
        while not self._over.wait(0.1):
            self.most = max(self.most, self.now())

    @staticmethod
    def _pss(pid: int) -> float:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text()
        except OSError:
            return 0.0
        match = re.search(r"^Pss:\s+(\d+) kB", text, re.MULTILINE)
        return int(match[1]) / 1024 if match else 0.0


if __name__ == "__main__":
    main()
