"""Every command: its files, its JSON fields, its exit codes; and that the first page comes at
once."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest
from children import child
from scipy.io import savemat

from cep.codes.sources import load_code
from cep.commands import console
from cep.commands.main import app
from cep.files.code_files import read_code
from cep.files.images import read_image, read_photo, write_image
from cep.files.psf_files import load_psf
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf, coded_psf
from cep.proofs.measure import CodeMetrics, measure
from cep.restoration.registry import METHODS
from hw.export import EXPORTERS
from motdiff.files.trajectories import StoredMotion, read_motion, write_motion
from motdiff.metrics import mnc_subpixel, psnr_up_to_shift
from motdiff.trajectory import Trajectory

COMMANDS = (
    "calibrate",
    "calibration-set",
    "advise",
    "optimize",
    "audit",
    "mtf",
    "simulate",
    "deblur",
    "export",
    "upload",
    "shoot",
    "studio",
    "demo",
)
SHUTTER = tuple(
    f"hw {name}" for name in ("info", "trigger", "abort", "calibrate", "verify", "emulate")
)
"""Talks with a device: nothing is drawn at random, and no file is written but those that an option
names."""
CAMERAS = ("camera list",)
"""Read a profile, and write no file."""
FILE_WRITERS = ("camera estimate", "hw timing")
GROUPED = (*CAMERAS, *FILE_WRITERS, *SHUTTER)
METRICS = {field.name for field in fields(CodeMetrics)}


# -- the program itself ---------------------------------------------------------------------------


def test_help_loads_nothing_heavy():
    """Instant help, shown by what is imported: no test asserts a wall time."""
    code = (
        "import sys; from cep.commands.main import main; code = main(['--help'])\nheavy ="
        " {'torch', 'matplotlib', 'scipy', 'skimage', 'cv2', 'numpy'} &"
        " set(sys.modules)\nassert code == 0 and not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    for command in COMMANDS:
        assert command in done.stdout


def test_version_is_the_installed_packages(cep):
    import cep as package

    assert cep("--version").code == 0
    assert cep.out.strip() == package.__version__ == version("coded-exposure")
    assert cep.err == ""
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = package.nothing


def test_version_of_an_uninstalled_copy(monkeypatch):
    import cep as package

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.version", missing)
    assert package.__version__ == "0+unknown"


def completions(*words):
    """Complete the last word as bash does, in a process of its own; loads nothing heavy."""
    code = (
        "import atexit, sys; from cep.commands.main import run\natexit.register(lambda:"
        " print('heavy:', {'torch', 'numpy', 'matplotlib'} & set(sys.modules)))\nrun()"
    )
    asked = {
        "_CEP_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, **asked},
    )
    *found, heavy = done.stdout.split("\n")[:-1]
    assert heavy == "heavy: set()"
    return found


def test_the_shell_completes_commands_and_options():
    assert completions("cep", "opt") == ["optimize"]
    assert completions("cep", "camera", "es") == ["estimate"]
    assert completions("cep", "optimize", "--obj") == ["--objective"]


def test_completion_can_be_installed(cep):
    cep("--help")
    assert {"--install-completion", "--show-completion"} <= set(cep.out.split())


@pytest.mark.parametrize("command", ["upload", *SHUTTER, *CAMERAS])
def test_every_command_without_files_has_help_with_an_example(cep, command):
    cep(*command.split(), "--help")
    assert cep.code == 0
    page = " ".join(cep.out.replace("Examples:", "Example:").split())
    for text in ("--json", "Example: cep " + command):
        assert text in page


@pytest.mark.parametrize(
    "command",
    [*(name for name in COMMANDS if name != "upload"), *FILE_WRITERS],
)
def test_every_command_has_help_with_an_example_and_the_common_options(cep, command):
    cep(*command.split(), "--help")
    assert cep.code == 0
    page = " ".join(cep.out.replace("Examples:", "Example:").split())
    output = (
        "--extract" if command == "studio" else "--output"
    )  # the studio writes a folder only when asked to
    for text in ("--json", "--force", output, "Example: cep " + command):
        assert text in page
    draws_nothing = (*FILE_WRITERS, "export", "shoot", "studio")
    assert ("--seed" in cep.out) == (command not in draws_nothing)


def test_commands_are_those_of_the_design():
    assert tuple(info.name for info in app.registered_commands) == COMMANDS
    groups = [
        f"{group.name} {info.name}"
        for group in app.registered_groups
        for info in group.typer_instance.registered_commands
    ]
    assert sorted(groups) == sorted(GROUPED)


def test_no_arguments_show_help(cep):
    assert cep().code == 0
    assert "Usage" in cep.out


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrat"],
        ["--nonsense"],
        ["audit"],
        ["audit", "1011", "--nonsense"],
        ["audit", "1011", "--flips", "many"],
        ["export", "1011", "--format", "csv", "--chip-ns", "0"],
        ["optimize", "--linear", "ten"],
        ["upload", "1011"],
    ],
)
def test_wrong_usage_is_one_line(cep, arguments):
    assert "--help" in cep.refuses(*arguments)


def test_an_interrupt_exits_130(cep, monkeypatch, workplace):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("cep.restoration.restore.restore", interrupted)
    before = sorted(workplace.iterdir())
    assert cep("deblur", "blurred.png", "--trajectory", "trajectory.json").code == 130
    assert (cep.out, cep.err) == ("", "cep: interrupted\n")
    assert sorted(workplace.iterdir()) == before


def test_progress_goes_to_stderr_of_a_terminal_only(capsys, monkeypatch):
    with console.progress("work") as tick:
        tick(0.5, "half")
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with console.progress("work") as tick:
        tick(0.5, "half")
    out, err = capsys.readouterr()
    assert out == ""
    assert "work" in err


# -- codes ----------------------------------------------------------------------------------------


def test_codes_by_bits_file_and_name(workplace):
    assert load_code("1011") == ShutterCode("1011")
    assert load_code("code.json").chip_ns == 250_000
    assert load_code("code.json", chip_ns=7).chip_ns == 7
    assert load_code("raskar-52").chips == 52


@pytest.mark.parametrize("chips", [256, 1024, 4096])
def test_bits_are_no_file_name_however_many_there_are(cep, workplace, chips):
    """A file name ends at some 255 characters, and asking whether a longer one is there fails."""
    bits = "".join(np.random.default_rng(chips).choice(["0", "1"], chips - 1)) + "1"
    written = cep.succeeds("export", bits, "--format", "csv", "-o", f"{chips}.csv")
    assert written["chips"] == chips
    assert EXPORTERS["csv"].parse_back(Path(f"{chips}.csv").read_text()).bits == bits
    # refused for their number, after they were read
    for command in (
        ["audit", bits],
        ["mtf", "--code", bits],
        ["simulate", "sharp.png", "--code", bits],
    ):
        assert f"{chips} " in cep.refuses(*command, "--linear", "5")
    assert f"{chips} " in cep.refuses(
        "deblur", "blurred.png", "--trajectory", "trajectory.json", "--code", bits
    )


@pytest.mark.parametrize("source", ["x" * 300, "raskar-53", "10" * 200 + "2"])
def test_what_is_neither_bits_nor_a_file_nor_a_name_is_one_line(cep, workplace, source):
    for command in (
        ["export", source, "--format", "csv"],
        ["audit", source],
        ["mtf", "--linear", "9", "--code", source],
    ):
        line = cep.refuses(*command)
        assert "0 and 1" in line if source[0] in "01" else "bits as 1011" in line


def test_a_file_named_in_bits_is_not_read(cep, workplace):
    Path("1011").write_text(Path("code.json").read_text())
    assert load_code("1011").chips == 4
    assert load_code("./1011").chips == 16
    assert cep.succeeds("export", "./1011", "--format", "csv")["file"] == "1011.csv"


def test_optimize(cep, workplace):
    arguments = (
        "optimize",
        "--trajectory",
        "trajectory.json",
        "--chips",
        "12",
        "--open",
        "40%:70%",
        "--steps",
        "3000",
    )
    found = cep.succeeds(*arguments, "--seed", "3", "--exposure", "6ms", "-o", "new.json")
    needed = {
        "bits",
        "chips",
        "open",
        "duty",
        "certificate",
        "bound",
        "gap",
        "seconds",
        "baselines",
    } | METRICS
    assert needed <= set(found)
    stored = read_code("new.json")
    assert stored.code == ShutterCode(found["bits"], 500_000)
    assert 0.4 <= found["duty"] <= 0.7
    names = {
        "open shutter",
        "best snapshot",
        "best strobe",
        "length-only code",
        "random code, median",
    }
    kept = {name for name, row in found["baselines"].items() if row["within_limits"]}
    assert names <= set(found["baselines"])
    assert kept >= {"length-only code", "random code, median"}
    for name, row in found["baselines"].items():
        assert row["within_limits"] == (5 <= row["open"] <= 8)
        assert name not in kept or found["mse_db"] <= row["mse_db"] + 1e-3
    assert (found["bound"], found["gap"]) == (
        None,
        None,
    )  # of the smallest MTF, which was not the objective
    # the worse of both directions, since the file does not know which
    motion = read_motion("trajectory.json").trajectory
    both = [measure(path, stored.code).mse_db for path in (motion, motion.reversed())]
    assert found["mse_db"] == pytest.approx(max(both))


def test_optimize_is_repeatable(cep, workplace):
    arguments = ("optimize", "--linear", "12", "--chips", "12", "--steps", "2000", "--seed", "5")
    first, second = (cep.succeeds(*arguments, "-o", name) for name in ("a.json", "b.json"))
    assert first["bits"] == second["bits"]
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()


def test_optimize_along_a_line_has_a_bound(cep, workplace):
    found = cep.succeeds(
        "optimize",
        "--linear",
        "10",
        "--chips",
        "10",
        "--open",
        "5",
        "--objective",
        "min-mtf",
        "--steps",
        "3000",
        "-o",
        "new.json",
    )
    assert found["min_chip"] <= found["bound"] <= np.sqrt(5) + 1e-6  # Parseval
    assert found["gap"] == pytest.approx(1 - found["min_chip"] / found["bound"])
    assert found["certificate"]["lower"] <= found["min_chip"] * (1 + 1e-9)
    best = max(  # brute force over all codes of five open chips out of ten
        _chip_minimum(bits) for bits in range(2**10) if bits.bit_count() == 5
    )
    assert found["min_chip"] == pytest.approx(best, rel=1e-3)


def test_optimize_along_a_curve_has_a_bound_of_its_minimum(cep, workplace):
    found = cep.succeeds(
        "optimize",
        "--trajectory",
        "trajectory.json",
        "--chips",
        "8",
        "--objective",
        "min-mtf",
        "--open",
        "4",
        "--steps",
        "1000",
        "-o",
        "new.json",
    )
    assert found["min_chip"] is None
    codes = [ShutterCode(f"{bits:08b}") for bits in range(2**8) if bits.bit_count() == 4]
    motion = read_motion("trajectory.json").trajectory
    line = np.linspace(-0.5, 0.5, 33)
    best = max(
        float(np.abs(coded_otf(motion, code, *np.meshgrid(line, line))).min())
        for code in codes[::5]
    )
    assert max(best, found["min_mtf"]) <= found["bound"] <= 0.5
    assert found["gap"] == pytest.approx(1 - found["min_mtf"] / found["bound"])


def test_noise_of_a_zero_is_more_than_100_db(cep, workplace):
    """An open shutter has zeros: how many dB a sample next to one shows is rounding, not news."""
    arguments = ("--linear", "12", "--code", "11", "--force")
    curve = cep.succeeds("mtf", *arguments)["curves"]["11"]
    assert curve["noise_gain_db"] is None
    assert curve["dnf_db"] is None
    cep("mtf", *arguments)
    assert "> 100" in cep.out
    assert "inf" not in cep.out
    cep("audit", "111111")
    assert "infinite" in cep.out  # its zeros are proven


def _chip_minimum(number):
    bits = [number >> k & 1 for k in range(10)]
    return np.abs(np.fft.rfft(bits, 4096)).min()


def test_optimize_keeps_a_devices_limits(cep, workplace):
    Path("slow.toml").write_text(
        'schema = "hw.device/1"\nname = "slow"\n'
        "min_on_ns = 2000000\nmin_off_ns = 3000000\nmax_pulses = 3\nmax_duty = 0.5\n"
    )
    found = cep.succeeds(
        "optimize",
        "--trajectory",
        "trajectory.json",
        "--chips",
        "20",
        "--device",
        "slow.toml",
        "--steps",
        "3000",
        "-o",
        "new.json",
    )
    code = ShutterCode(found["bits"])
    assert code.duty <= 0.5
    assert code.pulses <= 3
    opens = [length for bit, length in code.runs if bit]
    gaps = [length for bit, length in code.runs if not bit]
    assert min(opens) >= 2
    inner = gaps[(code.bits[0] == "0") : len(gaps) - (code.bits[-1] == "0")]
    assert min(inner, default=3) >= 3


def test_optimize_interrupted_keeps_the_best(cep, workplace, monkeypatch):
    from cep.search import code_search as module

    def interrupted_soon(problem, *, progress, **options):
        def stop(_fraction, _best):
            raise KeyboardInterrupt

        return real(problem, progress=stop, **options)

    real = module.anneal
    monkeypatch.setattr(module, "anneal", interrupted_soon)
    found = cep.succeeds(
        "optimize", "--linear", "20", "--chips", "16", "--steps", "100000", "-o", "new.json"
    )
    assert found["interrupted"]
    assert found["stopped"] == "interrupted"
    assert found["warnings"]
    assert read_code("new.json").code.bits == found["bits"]


def test_a_second_interrupt_does_not_lose_the_code(cep, workplace, monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("cep.search.optimized_code.compare", interrupted)
    assert (
        cep(
            "optimize", "--linear", "20", "--chips", "16", "--steps", "1000", "-o", "new.json"
        ).code
        == 130
    )
    assert cep.err == "cep: interrupted\n"
    stored = read_code("new.json")
    assert stored.code.chips == stored.problem["chips"] == 16


_LOUD = """
import sys
from cep.commands.main import run
from cep.search import code_search as module

real = module.anneal

def loud(problem, **options):
    def tell(fraction, best):
        print("searching", flush=True, file=sys.stderr)
    return real(problem, **(options | {"progress": tell}))

module.anneal = loud
run()
"""


def test_a_real_interrupt_of_a_long_search(workplace):
    limits = ["--chips", "12", "--steps", "1000000000", "--time", "600"]
    with child(
        [
            sys.executable,
            "-c",
            _LOUD,
            "optimize",
            "--linear",
            "20",
            *limits,
            "-o",
            "new.json",
            "--json",
        ],
        env=os.environ | {"PYTHONPATH": str(Path(console.__file__).parents[2])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stderr.readline() == "searching\n"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert json.loads(out)["interrupted"]
    assert read_code("new.json").code.bits == json.loads(out)["bits"]


def test_audit_finds_a_hidden_zero(cep, workplace):
    """MERL's 31-chip code claims a minimum of 1.85; it has a zero at a sixth of a cycle per
    chip."""
    found = cep.succeeds("audit", "merl-31-t62")
    assert set(found) >= METRICS
    assert found["null"]
    assert found["lowest_at"][0] == pytest.approx(1 / 6, abs=1e-6)
    assert "zero" in found["warnings"][0]
    better = found["neighbours"][0]
    assert len(better["flips"]) == 1
    assert better["minimum"] > 0.5


def test_audit_along_a_trajectory(cep, workplace):
    found = cep.succeeds(
        "audit", "code.json", "--trajectory", "trajectory.json", "--flips", "1", "-o", "audit.json"
    )
    assert found["certificate"]["lower"] <= found["certificate"]["upper"]
    assert found["min_chip"] is None
    assert json.loads(Path("audit.json").read_text()) == found


def test_mtf(cep, workplace):
    found = cep.succeeds(
        "mtf", "--trajectory", "trajectory.json", "--code", "code.json", "--code", "1011"
    )
    assert Path("mtf.png").read_bytes().startswith(b"\x89PNG")
    assert set(found["curves"]) == {"open shutter", "code", "1011"}
    curve = found["curves"]["1011"]
    assert curve["mtf"][0] == pytest.approx(0.75)
    assert set(curve) >= METRICS


# -- photos ---------------------------------------------------------------------------------------


def test_simulate_then_deblur(cep, workplace):
    taken = cep.succeeds(
        "simulate",
        "sharp.png",
        "--trajectory",
        "trajectory.json",
        "--code",
        "code.json",
        "--photons",
        "1e6",
        "--read-noise",
        "1",
        "-o",
        "coded.png",
    )
    assert {"image", "psf"} <= set(taken)
    motion = read_motion("trajectory.json").trajectory
    code = read_code("code.json").code
    np.testing.assert_array_equal(
        load_psf(taken["psf"])[0], coded_psf(motion, code).astype(np.float32)
    )
    coded = read_photo("coded.png")
    assert coded.bits == 16
    sharp = read_photo("sharp.png").pixels
    assert coded.pixels.mean() == pytest.approx(code.duty * sharp.mean(), rel=0.02)

    restored = cep.succeeds(
        "deblur", "coded.png", "--trajectory", "trajectory.json", "--code", "code.json"
    )
    assert {"image", "direction", "residual", "seconds"} <= set(restored)
    assert restored["direction"] == "forward"
    margin = (sharp.shape[0] - coded.pixels.shape[0]) // 2
    middle = sharp[
        margin : margin + coded.pixels.shape[0], margin : margin + coded.pixels.shape[1]
    ]
    sharpened = read_photo(restored["image"])
    assert sharpened.bits == 16
    assert (
        psnr_up_to_shift(sharpened.pixels, middle)
        > psnr_up_to_shift(coded.pixels / code.duty, middle) + 3
    )


def test_deblur_finds_the_reversed_direction(cep, workplace):
    stored = read_motion("trajectory.json")
    backwards = stored.trajectory.reversed()
    write_motion("backwards.json", type(stored)(backwards))
    options = ("--code", "code.json", "--photons", "1e6")
    cep.succeeds(
        "simulate", "sharp.png", "--trajectory", "backwards.json", *options, "-o", "coded.png"
    )
    restored = cep.succeeds(
        "deblur", "coded.png", "--trajectory", "trajectory.json", "--code", "code.json"
    )
    assert restored["direction"] == "reverse"
    assert 0.5 < restored["direction_confidence"] <= 1


def test_deblur_with_a_psf_and_without_a_code(cep, workplace):
    from cep.files.psf_files import write_psf

    write_psf(".", read_motion("trajectory.json").trajectory.psf())
    for method in METHODS:
        found = cep.succeeds(
            "deblur", "blurred.png", "--psf", "psf.npy", "--method", method, "-o", f"{method}.png"
        )
        assert found["residual"] < 0.05
    assert (
        cep.succeeds("deblur", "blurred.png", "--trajectory", "trajectory.json")["direction"]
        == "unknown"
    )


def test_simulation_repeats_with_its_seed(cep, workplace):
    for name, seed in (("a.png", 1), ("b.png", 1), ("c.png", 2)):
        cep.succeeds("simulate", "sharp.png", "--linear", "8", "--seed", str(seed), "-o", name)
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes() != Path("c.png").read_bytes()


def test_calibrate_with_a_sharp_photo(cep, workplace):
    found = cep.succeeds(
        "calibrate", "blurred.png", "--method", "reference", "--sharp", "sharp.png", "-o", "motion"
    )
    fields = {
        "method",
        "trajectory",
        "psf",
        "length_px",
        "extent_px",
        "confidence",
        "seconds",
        "warnings",
    }
    assert fields <= set(found)
    names = {
        "trajectory.json",
        "psf.npy",
        "psf.mat",
        "psf.png",
        "map.png",
        "preview.png",
        "sharpened.png",
    }
    assert {item.name for item in Path("motion").iterdir()} == names
    truth = read_motion("trajectory.json").trajectory
    stored = read_motion(found["trajectory"])
    assert stored.source["method"] == "reference"
    assert stored.trajectory.direction == "unknown"
    assert mnc_subpixel(load_psf(found["psf"])[0], truth.psf(64)) > 0.95


def test_files_of_levins_data_set_as_photos_and_psfs(cep, workplace):
    """There y is x convolved with f turned by 180 degrees, here along a path that does not look
    the same turned."""
    sharp = read_image("sharp.png")
    blurred = read_image("blurred.png")
    truth = read_motion("trajectory.json").trajectory.psf(25)
    margin = (sharp.shape[0] - blurred.shape[0]) // 2
    inner = sharp[margin:-margin, margin:-margin]
    savemat("im01_ker01.mat", {"x": inner, "y": blurred, "f": truth[::-1, ::-1]})
    found = cep.succeeds(
        "calibrate", "im01_ker01.mat", "--method", "reference", "--sharp", "im01_ker01.mat"
    )
    assert Path("im01_ker01_motion/trajectory.json").exists()
    assert any('"y" was taken as linear light' in line for line in found["warnings"])
    assert mnc_subpixel(load_psf(found["psf"])[0], truth) > 0.95
    assert mnc_subpixel(load_psf(found["psf"])[0], truth[::-1, ::-1]) < 0.9
    found = cep.succeeds(
        "deblur",
        "im01_ker01.mat",
        "--psf",
        "im01_ker01.mat",
        "--method",
        "tv",
        "-o",
        "restored.png",
    )
    assert found["residual"] < 0.02
    gain_db = psnr_up_to_shift(read_image("restored.png"), inner) - psnr_up_to_shift(
        blurred, inner
    )
    assert gain_db > 3


def test_calibrate_from_a_gyroscope(cep, workplace):
    t = np.arange(0, 1, 0.005)
    rows = [f"{s:.3f},{0.05 * np.sin(9 * s):.6f},{0.08 * np.cos(7 * s):.6f},0" for s in t]
    Path("gyro.csv").write_text("\n".join(["t_s,wx,wy,wz", *rows]))
    found = cep.succeeds(
        "calibrate",
        "blurred.png",
        "--method",
        "gyro",
        "--gyro",
        "gyro.csv",
        "--focal",
        "1000",
        "--exposure",
        "0.2",
        "--start",
        "0.3",
    )
    assert found["direction"] == "known"
    assert Path("blurred_motion/trajectory.json").exists()


GYRO = (
    "calibrate",
    "blurred.png",
    "--method",
    "gyro",
    "--gyro",
    "gyro.csv",
    "--focal",
    "1000",
    "--exposure",
    "0.2",
)


def test_a_recording_in_degrees(cep, workplace):
    """Read as rad/s it is refused with the question; the option or the header tells it, and the
    path is the same."""
    t = np.arange(0, 1, 0.005)
    rates = np.stack([0.5 * np.sin(9 * t), 0.8 * np.cos(7 * t), 0 * t], axis=1)

    def write(rates, head):
        np.savetxt(
            "gyro.csv", np.column_stack([rates, 1.6e9 + t]), "%.9f", ",", header=head, comments=""
        )

    start = ("--start", "1600000000.3")
    write(rates, "wx,wy,wz,t_s")
    truth = cep.succeeds(*GYRO, *start, "-o", "truth")["length_px"]
    write(np.degrees(rates), "wx,wy,wz,t_s")
    assert re.match(r"cep: --gyro-unit: .*deg/s", cep.refuses(*GYRO, *start, "-o", "none"))
    assert not Path("none").exists()
    assert cep.succeeds(*GYRO, *start, "--gyro-unit", "deg", "-o", "a")[
        "length_px"
    ] == pytest.approx(truth, rel=1e-6)
    write(np.degrees(rates), "gx_dps,gy_dps,gz_dps,t_s")
    assert cep.succeeds(*GYRO, *start, "-o", "b")["length_px"] == pytest.approx(truth, rel=1e-6)
    assert "--gyro-unit" in cep.refuses(*GYRO, *start, "--gyro-unit", "rad", "-o", "none")
    assert "--gyro-unit: must be rad or deg" in cep.refuses(
        *GYRO, *start, "--gyro-unit", "rpm", "-o", "none"
    )
    line = cep.refuses(*GYRO, "--start", "1600000000.9", "-o", "none")
    assert line.startswith(
        "cep: --start: the exposure 1600000000.9000..1600000001.1000 s must lie within"
    )
    assert "--gyro-unit" in cep.refuses("calibrate", "blurred.png", "--gyro-unit", "deg")


def test_calibrate_from_a_point_of_light(cep, workplace):
    motion = Trajectory.from_samples([[0, 0], [10, 3], [12, 12]])
    night = np.full((128, 128), 0.01)
    night[32:96, 32:96] += 8 * motion.psf(64)
    write_image("night.png", night, bits=16)
    found = cep.succeeds("calibrate", "night.png", "--method", "point")
    assert found["length_px"] == pytest.approx(motion.length_px, rel=0.15)


# -- shutters -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(EXPORTERS))
def test_export_reads_back(cep, workplace, name):
    found = cep.succeeds("export", "code.json", "--format", name, "-o", "program.txt")
    assert {"runs", "edges", "duration_ns", "checks", "trust"} <= set(found)
    program = EXPORTERS[name].parse_back(Path("program.txt").read_text())
    assert program.bits == read_code("code.json").code.bits
    assert found["duration_ns"] == 16 * 250_000
    assert [list(edge) for edge in program.edges] == found["edges"]


def test_export_never_replaces_its_code(cep, workplace):
    before = Path("code.json").read_bytes()
    assert cep.succeeds("export", "code.json", "--format", "json")["file"] == "code.program.json"
    assert "is what is read" in cep.refuses(
        "export", "code.json", "--format", "json", "-o", "code.json", "--force"
    )
    assert Path("code.json").read_bytes() == before


@pytest.mark.parametrize("source", ["code.json", "1101"])
def test_an_exported_script_hides_no_module_of_pythons(cep, workplace, source):
    file = Path(cep.succeeds("export", source, "--format", "rp2")["file"])
    assert file.suffix == ".py"
    assert file.stem.startswith("code")
    assert file.stem not in sys.stdlib_module_names


def test_human_pages(cep, workplace):
    """Without --json every command prints something for people, and nothing on stderr."""
    for arguments in (
        ["audit", "1101", "--flips", "1"],
        ["mtf", "--linear", "5", "--code", "1101"],
        ["simulate", "sharp.png", "--linear", "5"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json"],
        ["export", "1101", "--format", "csv"],
        ["optimize", "--linear", "8", "--chips", "8", "--steps", "500", "-o", "new.json"],
    ):
        cep(*arguments)
        assert (cep.code, cep.err) == (0, ""), arguments
        assert cep.out.strip()


def test_what_rounding_leaves_of_a_zero_is_told_as_zero(cep, workplace):
    """There and back twice along 8 px: the open shutter's MTF is that of a box, 0 at 1/8
    cycles/px."""
    path = Trajectory.from_samples([[0, 0], [8, 0], [0, 0], [8, 0], [0, 0]])
    write_motion("back.json", StoredMotion(path, source={"method": "test"}))
    found = cep.succeeds("mtf", "--trajectory", "back.json")["curves"]["open shutter"]
    assert 0 < found["min_mtf"] < 1e-12  # JSON keeps it
    searched = [
        "optimize",
        "--trajectory",
        "back.json",
        "--chips",
        "10",
        "--open",
        "5",
        "--steps",
        "500",
    ]
    for arguments in (
        ["mtf", "--trajectory", "back.json", "-o", "again.png"],
        ["audit", "1100110011", "--trajectory", "back.json", "--flips", "0"],
        [*searched, "-o", "new.json"],
    ):
        cep(*arguments)
        assert cep.code == 0, cep.err
        # but what is proven is told as it is proven: an upper bound of 1e-13 is no zero
        told = [
            line for line in cep.out.splitlines() if not line.startswith(("smallest", "certified"))
        ]
        assert not re.search(r"\de-1\d", "\n".join(told)), cep.out
