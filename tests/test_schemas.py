"""JSON Schemas of the files: valid, of what is written, and of one mind with the readers."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from cep.calibration.calibration_set import calibration_set
from cep.files.code_files import StoredCode, read_code, write_code
from cep.optics.camera import Camera, camera_names
from cep.optics.code import ShutterCode
from cep.search.optimize import optimize
from cep.studio.documents import read_document
from hw.export import export_program
from hw.program import Program
from lab.bench.table_io import Provenance, made_json, tables_json
from lab.bench.tables import Column, tabulate
from lab.fronts.comparison import pareto
from motdiff.files.json_files import fault, json_text, load_schema
from motdiff.files.trajectories import StoredMotion, read_motion, write_motion
from motdiff.trajectory import Trajectory

ROOT = Path(__file__).resolve().parent.parent
BENT = Trajectory.from_samples([[0, 0], [8, 2], [9, 9]], direction="known")


def extension():
    spec = importlib.util.spec_from_file_location(
        "schema_tables", ROOT / "docs" / "_extensions" / "schema_tables.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FILES = extension().schema_files()


def schema(name):
    packages = extension().PACKAGES
    return load_schema(next(package for package in packages if name in packages[package]), name)


def faults(document, name, part=None):
    found = schema(name)["$defs"][part] if part else schema(name)
    return [
        f"{error.json_path}: {error.message}"
        for error in Draft202012Validator(found).iter_errors(document)
    ]


# -- the schemas themselves -----------------------------------------------------------------------


def test_every_schema_of_the_packages_is_listed():
    folders = {path.parent for path in FILES.values()}
    assert sorted(FILES.values()) == sorted(
        path for folder in folders for path in folder.glob("*.json")
    )


@pytest.mark.parametrize("name", FILES)
def test_a_schema_is_one_and_has_only_keywords_that_readers_know(name):
    Draft202012Validator.check_schema(schema(name))
    assert schema(name)["$schema"] == "https://json-schema.org/draft/2020-12/schema"


def test_a_keyword_that_readers_would_pass_over_is_refused(tmp_path, monkeypatch):
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "odd.json").write_text('{"properties": {"a": {"multipleOf": 2}}}')
    monkeypatch.setattr("motdiff.files.json_files.resources.files", lambda _: tmp_path)
    with pytest.raises(ValueError, match=r"odd\.json: unknown keyword 'multipleOf'"):
        load_schema("nowhere", "odd")


def test_the_page_of_files_names_all_fields():
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert extension().with_tables(page) == page, "run python docs/_extensions/schema_tables.py"
    assert {name.partition("#")[0] for name in extension()._MARKED.findall(page)} == FILES.keys()


# -- what is written ------------------------------------------------------------------------------


def written(path):
    return json.loads(Path(path).read_text(encoding="utf-8"))


@pytest.mark.parametrize("alternatives", [(), ((0.25, BENT.reversed()),)])
def test_motions(tmp_path, alternatives):
    source = {"method": "pmp", "image": "a.png", "seed": 0, "path_uncertainty_px": 0.4}
    write_motion(tmp_path / "t.json", StoredMotion(BENT, 0.75, alternatives, source))
    assert faults(written(tmp_path / "t.json"), "trajectory") == []


def test_codes(tmp_path):
    write_code(tmp_path / "bare.json", StoredCode(ShutterCode("1011", 5)))
    assert faults(written(tmp_path / "bare.json"), "code") == []
    from cep.search.problem import SearchProblem

    for name, path in {"straight": Trajectory.straight(8.0), "bent": BENT}.items():
        optimize(SearchProblem.along(path, chips=8), steps=300).save(tmp_path / f"{name}.json")
        assert faults(written(tmp_path / f"{name}.json"), "code") == []
        assert written(tmp_path / f"{name}.json")["certificate"]


def test_cameras(tmp_path):
    for name in camera_names():
        Camera.load(name).to_file(tmp_path / "c.json")
        assert faults(written(tmp_path / "c.json"), "camera") == []


def test_fronts():
    from cep.search.problem import SearchProblem

    found = pareto(SearchProblem.along(chips=8, open_range=(3, 5)), steps=500, seed=0)
    assert faults(json.loads(json_text(found.stored({"linear_px": None}))), "front") == []


def test_calibration_sets(tmp_path):
    made = calibration_set(2, chips=8, rng=np.random.default_rng(0))
    made.save(tmp_path / "set")
    assert faults(written(tmp_path / "set" / "set.json"), "calibration-set") == []
    assert faults(written(tmp_path / "set" / "code_2.json"), "code") == []


def test_tables_of_the_benchmarks():
    figures = {
        (row, photo, "m"): {"gain": float(len(row) + len(photo))}
        for row in ("a", "bb")
        for photo in ("p", "qq")
    }
    columns = [Column("gain", "gain, dB", "high")]
    table = tabulate("t", figures, columns, rng=np.random.default_rng(0), cluster=(1, 2))
    about = Provenance(
        command="python -m lab bench",
        seed=0,
        warnings=["few"],
        machines=[
            {
                "processor": "x",
                "cores": 2,
                "memory_gib": None,
                "system": "s",
                "python": "3",
                "versions": {},
            },
        ],
    )
    assert faults(json.loads(tables_json([table], about)), "bench") == []
    codes = {"codes": [{"name": "raskar-52", "chips": 4, "open": 3, "bits": "1011"}]}
    assert faults(json.loads(made_json(codes, about)), "bench") == []


def test_proofs():
    for path in sorted((ROOT / "docs" / "proofs").glob("*.jsonl"))[:3]:
        header, *records = path.read_text(encoding="utf-8").splitlines()
        assert faults(json.loads(header), "proof", "header") == []
        for record in records[:20]:
            assert faults(json.loads(record), "proof", "record") == []
            assert faults(json.loads(record), "proof") == []


def test_programs():
    assert (
        faults(json.loads(export_program(Program("10110", chip_ns=1000), "json")), "program") == []
    )


# -- of one mind with the readers -----------------------------------------------------------------

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-3, 20)
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from([1.0, 12.0, "px", "known", "unknown", "linear", "srgb", "1011", "000", ""])
    | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["t", "x", "y", "weight"]), inner, max_size=3)
    ),
    max_leaves=6,
)


def places(value, here=()):
    """Every place within a document, the document itself left out."""
    inner = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, item in inner:
        yield (*here, key)
        yield from places(item, (*here, key))


@st.composite
def mutated(draw, document):
    """A document with one or two of its values replaced, left out or added."""
    changed = json.loads(json.dumps(document))
    for _ in range(draw(st.integers(1, 2))):
        place = draw(st.sampled_from(sorted(places(changed), key=str) or [("schema",)]))
        holder = changed
        for key in place[:-1]:
            holder = holder[key]
        what = draw(st.sampled_from(["replace", "replace", "drop", "add"]))
        if what == "drop":
            del holder[place[-1]]
        elif what == "add" and isinstance(holder, dict):
            holder[draw(st.sampled_from(["iso", "weight", "gain_e_per_dn", "source"]))] = draw(
                VALUES
            )
        else:
            holder[place[-1]] = draw(VALUES)
    return changed


SAMPLES = {"t": [0, 0.25, 1], "x": [0.0, 1.5, -2.0], "y": [0, 1, 0]}
MOTION = {
    "schema": "cep.trajectory/1",
    "units": "px",
    "direction": "known",
    **SAMPLES,
    "weight": 0.5,
    "alternatives": [{"weight": 0.5, **SAMPLES}],
    "source": {"method": "pmp"},
}
CODE = {
    "schema": "cep.code/1",
    "bits": "1011",
    "chip_ns": 1000,
    "metrics": {"min_mtf": 0.1},
    "problem": {},
    "certificate": None,
}
CAMERA = Camera.load("sony-imx250").to_dict()
STUDIO = {
    "schema": "cep.studio/1",
    "state": {"bits": "1"},
    "trajectory": {},
    "code": {},
    "commands": ["cep audit 1"],
}
BEYOND = {
    "trajectory": ("equally long", "strictly increasing", "from 0 to 1"),
    "code": ("only 0 and 1",),
    "camera": ("needs response", "must be one line of text"),
    "studio": (),
}
"""Reasons of readers that no schema can have, or that its regular expressions do not reach."""


def read_camera(path):
    return Camera.from_file(path)


READERS = {
    "trajectory": (MOTION, read_motion),
    "code": (CODE, read_code),
    "camera": (CAMERA, read_camera),
    "studio": (STUDIO, read_document),
}


@pytest.mark.parametrize("name", READERS)
def test_reader_and_schema_accept_the_same(name, tmp_path_factory):
    document, read = READERS[name]
    path = tmp_path_factory.mktemp(name) / "file.json"

    @settings(max_examples=300)
    @given(mutated(document))
    def agree(changed):
        path.write_text(json.dumps(changed), encoding="utf-8")
        wrong = faults(changed, name)
        assert (fault(changed, schema(name)) is None) == (not wrong), (changed, wrong)
        try:
            read(path)
        except ValueError as error:
            refused = str(error)
            assert "\n" not in refused
            assert wrong or any(reason in refused for reason in BEYOND[name]), (changed, refused)
        else:
            assert not wrong, (changed, wrong)

    assert faults(document, name) == []
    read(_stored(path, document))
    agree()


def _stored(path, document):
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


@given(mutated(json.loads(export_program(Program("10110", chip_ns=1000), "json"))))
def test_a_program_is_checked_as_its_schema_has_it(changed):
    assert (fault(changed, schema("program")) is None) == (not faults(changed, "program"))


def test_a_pattern_ends_where_the_text_ends():
    schema = {"type": "string", "pattern": "^[01]+$"}
    assert fault("01", schema) is None
    assert fault("01\n", schema) is not None


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (lambda: float("nan"), "a: must be a finite number within 0..1, got NaN"),
        (lambda: True, "a: must be a number within 0..1, got true"),
        (lambda: [1], "a: must be a number within 0..1, got a list of 1"),
        (lambda: 10**5000, "a: must be a number within 0..1, got a number of thousands of digits"),
        (lambda: "x" * 10_000, 'a: must be a number within 0..1, got "xxx'),
    ],
)
def test_a_fault_is_one_short_line(value, said):
    found = fault(
        {"a": value()}, {"properties": {"a": {"type": "number", "minimum": 0, "maximum": 1}}}
    )
    assert found.startswith(said)
    assert len(found) < 400
    assert len(found.splitlines()) == 1
