"""The house rules, read from the source: layers, circles, heavy imports, size, and what each module says of itself."""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("cep", "motdiff", "hw")

MAY_IMPORT = {
    "motdiff": {"motdiff"},  # motion knows nothing of shutters or codes: it is useful without them
    "hw": {"hw"},  # a shutter is driven without numpy, photos or theory
    "cep": {"cep", "motdiff", "hw"},
}

HEAVY = {
    "torch": "seconds to import; only the network and pmp packages, which nobody imports without wanting them",
    "cvxpy": "seconds to import; only a bound or a certificate needs it",
    "matplotlib": "half a second to import; pyplot besides keeps global state",
    "skimage": "a second to import",
    "numba": "a second to import; one module wraps it for the compiled loops of the search",
}
HEAVY_ALLOWED = {
    "numba": ("cep/compiled.py",),
    "torch": (  # torch packages and modules throughout
        "cep/baselines/dce/",
        "cep/restore/denoiser/",
        "motdiff/conditions.py",
        "motdiff/diffusion.py",
        "motdiff/estimators/blinddps.py",
        "motdiff/estimators/motdiff/",
        "motdiff/estimators/pmp/",
        "motdiff/estimators/selfdeblur/",
        "motdiff/grids.py",
        "motdiff/losses.py",
        "motdiff/network/",
        "motdiff/parallel.py",
        "motdiff/sampling.py",
        "motdiff/training/",
        "motdiff/weights/",
    ),
}

LIGHT_CLI = {
    "__future__",
    "collections",
    "contextlib",
    "dataclasses",
    "os",
    "pathlib",
    "signal",
    "sys",
    "time",
    "traceback",
    "typing",
    "typer",
    "cep",
}
"""What the command modules may import at their top: `cep --help` answers in under half a second."""

LONGEST = 300
LONGER_ALLOWED = {
    "motdiff/trajectory.py": "one class, a third of it docstrings; every method is a physical property of the path",
}

MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
PUBLIC = [path for path in MODULES if not path.name.startswith("_")]


def name_of(path):
    return str(path.relative_to(ROOT))


@cache
def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def dotted(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(nodes):
    """Yield every absolute module name, `from a import b` as both a and a.b, since b may be a module."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}: write the whole name"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def runtime_top_level(tree):
    """Yield the statements that run on import: class bodies and try blocks too, TYPE_CHECKING blocks not."""
    pending = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            pending.extend(
                child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt | ast.excepthandler)
            )


def test_the_rules_have_something_to_rule():
    assert {path.relative_to(ROOT).parts[0] for path in MODULES} == set(PACKAGES)
    assert len(MODULES) > 30


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_no_package_imports_upward(path):
    own = path.relative_to(ROOT).parts[0]
    ours = {name for name in imported(ast.walk(tree_of(path))) if name and name.split(".")[0] in PACKAGES}
    assert {name for name in ours if name.split(".")[0] not in MAY_IMPORT[own]} == set()


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_heavy_libraries_are_imported_where_they_are_needed(path):
    top = {name.split(".")[0] for name in imported(runtime_top_level(tree_of(path)))}
    wrong = {
        library: reason
        for library, reason in HEAVY.items()
        if library in top and not name_of(path).startswith(HEAVY_ALLOWED.get(library, ("-",)))
    }
    assert wrong == {}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_torchvision_and_pyplot_are_never_imported(path):
    names = set(imported(ast.walk(tree_of(path))))
    assert not {name for name in names if name.startswith(("torchvision", "matplotlib.pyplot", "pylab"))}


@pytest.mark.parametrize("path", [p for p in MODULES if name_of(p).startswith("cep/cli/")], ids=name_of)
def test_commands_start_light(path):
    names = set(imported(runtime_top_level(tree_of(path))))
    assert {name.split(".")[0] for name in names} <= LIGHT_CLI
    assert {name for name in names if name.startswith("cep.") and not name.startswith("cep.cli")} == set()


@pytest.mark.parametrize("path", PUBLIC, ids=name_of)
def test_every_public_module_says_what_it_is_and_offers(path):
    tree = tree_of(path)
    assert ast.get_docstring(tree), "no docstring"
    empty_package = path.name == "__init__.py" and len(tree.body) == 1
    if empty_package or path.name == "__main__.py":
        return  # nothing is offered for import
    listed = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
    ]
    assert len(listed) == 1, "no __all__"
    offered = ast.literal_eval(listed[0])
    defined = {
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            defined.add(node.id)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            defined |= {alias.asname or alias.name for alias in node.names}
    assert set(offered) <= defined
    assert len(set(offered)) == len(offered)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_is_one_idea(path):
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST or name_of(path) in LONGER_ALLOWED, f"{lines} lines: split it"


def test_longer_modules_are_really_longer():
    """An allowance that is no longer needed must go."""
    for name in LONGER_ALLOWED:
        assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) > LONGEST


def test_no_import_circle():
    names = {dotted(path): path for path in MODULES}
    graph = {
        module: {other for other in imported(runtime_top_level(tree_of(path))) if other in names and other != module}
        for module, path in names.items()
    }
    state = {}

    def visit(module, trail):
        if state.get(module) == "done":
            return
        assert module not in trail, " -> ".join([*trail[trail.index(module) :], module])
        for other in sorted(graph[module]):
            visit(other, [*trail, module])
        state[module] = "done"

    for module in sorted(graph):
        visit(module, [])


def test_the_checks_catch_offenders():
    """The readers above see imports in class bodies and try blocks, and not those for type checkers."""
    source = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    import cvxpy\n"
        "try:\n    import torch\nexcept ImportError:\n    import skimage.io\n"
        "class A:\n    import matplotlib.pyplot\n"
        "def f():\n    import hw.program\n"
    )
    tree = ast.parse(source)
    assert set(imported(runtime_top_level(tree))) == {
        "typing", "typing.TYPE_CHECKING", "torch", "skimage.io", "matplotlib.pyplot",
    }  # fmt: skip
    assert "hw.program" in set(imported(ast.walk(tree)))
