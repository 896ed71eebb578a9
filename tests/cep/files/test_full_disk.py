"""Outputs of a command appear together or not at all, whichever write or rename fails."""

import os
import subprocess
import sys
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from full_disk import failing_rename, full_disk

from cep.files.code_files import read_code
from cep.plots.canvas import new_figure
from cep.search.problem import SearchProblem
from lab.fronts.search import pareto_front
from motdiff.files.outputs import new_files, new_folder, write_text
from motdiff.files.trajectories import read_motion


def contents(folder):
    """Every file and folder below ``folder``, hidden ones too."""
    return {
        str(item): item.read_bytes() if item.is_file() else None
        for item in sorted(Path(folder).rglob("*"))
    }


def relative(folder):
    return {str(Path(name).relative_to(folder)): data for name, data in contents(folder).items()}


def error_of(write, folder):
    try:
        write(folder)
    except OSError as error:
        return error
    return None


def write_set(folder):
    with new_files([folder / "a.txt", folder / "b.txt", folder / "c.txt"]) as made:
        for number, temporary in enumerate(made.values()):
            write_text(temporary, f"new {number}")


def write_folder(folder):
    with new_folder(folder, ["a.txt", "b.txt", "c.txt", "gone.txt"], force=True) as made:
        for number, name in enumerate(("a.txt", "b.txt", "c.txt")):
            write_text(made / name, f"new {number}")


def write_deep_folder(folder):
    write_folder(folder / "deep" / "down")


@pytest.mark.parametrize(
    "old", [(), ("b.txt",), ("a.txt", "b.txt", "c.txt"), ("gone.txt",), ("a.txt", "gone.txt")]
)
@pytest.mark.parametrize("write", [write_set, write_folder, write_deep_folder])
@pytest.mark.parametrize(
    "fault",
    [full_disk, failing_rename, partial(failing_rename, links=False)],
    ids=["disk", "rename", "no links"],
)
def test_all_files_or_none(tmp_path, monkeypatch, write, old, fault):
    option = "writes" if fault is full_disk else "number"

    def prepared(name):
        folder = tmp_path / name
        folder.mkdir()
        for one in old:
            (folder / one).write_text(f"old {one}")
        return folder

    whole = prepared("whole")
    with fault(monkeypatch) as counted:
        write(whole)
    assert {item.read_text() for item in whole.rglob("*.txt")} == {"new 0", "new 1", "new 2"} | {
        f"old {name}"
        for name in old
        if write is not write_folder and (write is write_deep_folder or name == "gone.txt")
    }
    failed = 0
    for number in range(len(counted)):
        folder = prepared(str(number))
        before = contents(folder)
        with fault(monkeypatch, **{option: number}):
            error = error_of(write, folder)
        if error is None:
            assert relative(folder) == relative(whole)
        else:
            failed += 1
            assert contents(folder) == before
            # the name of an output, not a hidden one
            assert not any(part.startswith(".") for part in Path(error.filename).parts)
    assert failed >= 3


def test_an_interrupt_between_two_renames(tmp_path, monkeypatch):
    (tmp_path / "b.txt").write_text("old")
    before = contents(tmp_path)
    replace = Path.replace

    def interrupted(self, target):
        if Path(target).name == "c.txt":
            raise KeyboardInterrupt
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_set(tmp_path)
    assert contents(tmp_path) == before


def test_what_cannot_be_restored_is_kept_and_named(tmp_path, monkeypatch):
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text(f"old {name}")
    replace = Path.replace

    def broken(self, target):
        if Path(target).parent == tmp_path and self.read_text() != "new 0":
            raise OSError(5, "Input/output error", str(self))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(OSError, match="Input/output") as caught:
        write_set(tmp_path)
    (note,) = caught.value.__notes__
    assert note.startswith(f"the earlier {tmp_path / 'a.txt'} is kept as ")
    assert (
        Path(note.removeprefix(f"the earlier {tmp_path / 'a.txt'} is kept as ")).read_text()
        == "old a.txt"
    )
    assert (tmp_path / "b.txt").read_text() == "old b.txt"


@pytest.mark.parametrize("links", [True, False])
def test_what_another_process_wrote_meanwhile_is_not_replaced(tmp_path, monkeypatch, links):
    """Only the step that renames can tell: a check before it leaves a moment between."""

    def write(name, text, *others):
        with new_files(
            [tmp_path / name, *(tmp_path / one for one in others)], force=False
        ) as made:
            for temporary in made.values():
                write_text(temporary, text)
            for one in others or (name,):  # the other process is faster
                (tmp_path / one).write_text("theirs")

    def write_into(folder, text):
        with new_folder(folder, ["a.txt"]) as made:
            write_text(made / "a.txt", text)
            (folder / "a.txt").write_text("theirs")

    with failing_rename(monkeypatch, links=links):
        for others in ((), ("b.txt",), ("b.txt", "c.txt")):
            with pytest.raises(
                ValueError, match=r"\.txt: exists already, use --force to replace it"
            ):
                write("a.txt", "ours", *others)
            assert relative(tmp_path) == dict.fromkeys(others or ("a.txt",), b"theirs")
            for name in others or ("a.txt",):
                (tmp_path / name).unlink()
        (tmp_path / "out").mkdir()
        with pytest.raises(ValueError, match="exists already"):
            write_into(tmp_path / "out", "ours")
        with new_files([tmp_path / "d.txt"], force=False) as made:
            write_text(made[tmp_path / "d.txt"], "ours")
    assert relative(tmp_path) == {"out": None, "out/a.txt": b"theirs", "d.txt": b"ours"}


def test_a_disk_that_is_full_only_when_it_is_flushed(tmp_path, monkeypatch):
    """As over a network: writing succeeds, and the files are not there."""
    (tmp_path / "a.txt").write_text("old")
    before = contents(tmp_path)
    monkeypatch.setattr(
        os, "fsync", lambda _file: (_ for _ in ()).throw(OSError(28, "No space left on device"))
    )
    error = error_of(write_set, tmp_path)
    assert error.filename == str(tmp_path / "a.txt")
    assert contents(tmp_path) == before


def test_two_names_of_one_file_are_refused(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with (
        pytest.raises(ValueError, match="the same file"),
        new_files([tmp_path / "real", tmp_path / "link"]),
    ):
        pass
    assert [item.name for item in tmp_path.iterdir()] == ["link"]


# -- commands -------------------------------------------------------------------------------------

COMMANDS = {
    "optimize": (
        "optimize",
        "--linear",
        "8",
        "--chips",
        "8",
        "--steps",
        "5",
        "-o",
        "out/code.json",
    ),
    "mtf": ("mtf", "--linear", "8", "-o", "out/mtf.svg", "--table", "out/mtf.csv"),
    "simulate": (
        "simulate",
        "sharp.png",
        "--trajectory",
        "trajectory.json",
        "-o",
        "out/photo.png",
    ),
    "hw verify": (
        "hw",
        "verify",
        "110100100011",
        "--chip-ns",
        "200000",
        "--vcd",
        "played.vcd",
        "--signal",
        "shutter",
        "--linear",
        "20",
        "-o",
        "out/seen.json",
    ),
    "calibrate": (
        "calibrate",
        "blurred.png",
        "--method",
        "gyro",
        "--gyro",
        "gyro.csv",
        "--focal",
        "2000",
        "--start",
        "0.1",
        "--exposure",
        "0.1",
        "-o",
        "out",
    ),
}


@pytest.fixture
def ready(cep, workplace):
    cep.succeeds(
        "export", "110100100011", "--chip-ns", "200000", "--format", "vcd", "-o", "played.vcd"
    )
    t = np.linspace(0, 0.3, 200)
    rows = np.column_stack([t, 0.05 * np.sin(40 * t), 0.05 * np.cos(30 * t), 0 * t])
    np.savetxt("gyro.csv", rows, delimiter=",", header="t_s,wx,wy,wz", comments="")
    return workplace


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_leaves_all_its_files_or_none(cep, ready, monkeypatch, name):
    def emptied():
        for folder in ("out", "figures"):
            Path(folder).mkdir(exist_ok=True)
            for item in Path(folder).iterdir():
                item.unlink()

    front = cache(
        partial(
            pareto_front,
            SearchProblem.along(chips=8),
            rng=np.random.default_rng(0),
            steps=50,
        )
    )
    # a search takes a second each time
    monkeypatch.setattr(
        "lab.fronts.comparison.pareto_front", lambda *_arguments, **_options: front()
    )
    for figure in (
        "lab.fronts.comparison.pareto_figure",
        "cep.calibration.calibrate.trajectory_figure",
    ):
        monkeypatch.setattr(figure, lambda *_arguments: new_figure(1, 1))
    arguments = (*COMMANDS[name], "--force")
    emptied()
    with full_disk(monkeypatch) as written, failing_rename(monkeypatch) as renamed:
        cep.succeeds(*arguments)
    outputs = sorted(item for folder in ("out", "figures") for item in Path(folder).iterdir())
    # a search writes its code alone, every other command several files
    assert len(outputs) > (0 if name == "optimize" else 1)
    faults = [(full_disk, {"writes": number}) for number in range(len(written))]
    faults += [(failing_rename, {"number": number}) for number in range(len(renamed))]
    failed = 0
    for number, (fault, options) in enumerate(faults):
        emptied()
        for output in outputs[number % 2 :: 2]:  # some are there from before, others not
            output.write_text("old")
        before = contents(".")
        with fault(monkeypatch, **options):
            cep(*arguments)
        assert cep.code in (0, 1)
        assert cep.code == 0 or (cep.err.startswith("cep: ") and cep.err.count("\n") == 1), cep.err
        after = contents(".")
        changed = {
            path for path in after.keys() | before.keys() if after.get(path) != before.get(path)
        }
        expected = {str(output) for output in outputs} if cep.code == 0 else set()
        assert changed in (set(), expected), (fault, options)
        failed += cep.code
    assert failed > len(outputs)


FOUND = {
    "calibration-set": ("calibration-set", "--photos", "2", "--chips", "4", "-o", "set"),
    "calibrate": (*COMMANDS["calibrate"][:-1], "motion"),
    "optimize": ("optimize", "--linear", "8", "--chips", "8", "--steps", "5", "-o", "best.json"),
}


@pytest.mark.parametrize("name", FOUND)
@pytest.mark.parametrize("fault", ["disk", "taken"])
def test_what_was_found_is_told_where_it_cannot_be_written(cep, ready, monkeypatch, name, fault):
    """On a full disk, and where another process has written files of the same names meanwhile."""
    (output,) = FOUND[name][-1:]
    file = Path(output, "trajectory.json" if name == "calibrate" else "set.json")
    file = file if name in ("calibrate", "calibration-set") else Path(output)

    def told(*arguments):
        before = contents(".")
        if fault == "disk":
            with full_disk(monkeypatch, writes=0):
                line = cep.fails(*arguments)
            assert contents(".") == before
            return line
        link = os.link

        def late(source, target, **options):
            if Path(target).name == file.name:
                Path(target).write_text("theirs")
            return link(source, target, **options)

        with monkeypatch.context() as patch:
            patch.setattr(os, "link", late)
            line = cep.refuses(*arguments)
        assert set(contents(".")) - set(before) <= {str(file), str(file.parent)}
        assert file.read_text() == "theirs"
        assert "exists already, use --force" in line
        return line

    line = told(*FOUND[name])
    found = line.rstrip("\n").partition("; found: ")[2]
    if name == "calibrate":
        Path("again.json").write_text(found)
        assert read_motion("again.json").trajectory.length_px > 1
    else:
        assert all(set(bits) <= set("01") for bits in found.split(", "))
        assert len(found) > 4


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError("1 GiB")])
@pytest.mark.parametrize("command", ["optimize", "frames"])
def test_a_comparison_that_ends_early_loses_no_code(
    cep, lab, workplace, monkeypatch, error, command
):
    def ended(*_arguments, **_options):
        raise error

    for place in ("cep.search.optimized_code.compare", "lab.frames.optimum.joint_figures"):
        monkeypatch.setattr(place, ended)
    run = lab if command == "frames" else cep
    run(command, "--linear", "8", "--chips", "8", "--steps", "5", "-o", "best.json")
    files = sorted(str(path) for path in Path().glob("best*.json"))
    if isinstance(error, KeyboardInterrupt):
        assert run.code == 130
        assert files == (["best_1.json", "best_2.json"] if command == "frames" else ["best.json"])
        assert all(read_code(file).code.chips == 8 for file in files)
    else:
        assert run.code == 1
        assert files == []
        assert set(run.err.rstrip("\n").partition("; found: ")[2]) >= {"0", "1"}


def test_a_real_limit_on_file_sizes(ready):
    """The photo fits, its PSF does not: nothing is left, in a process of its own."""
    code = (
        "import resource, signal, sys; from cep.commands.main import main;"
        " signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE,"
        " (8192, 8192)); sys.exit(main(sys.argv[1:]))"
    )
    Path("out").mkdir()
    arguments = COMMANDS["hw verify"]
    before = contents(".")
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (1, "cep: out/seen_psf.npy: File too large\n")
    assert contents(".") == before
