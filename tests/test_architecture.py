"""The rules of the design, read from the source: layers, circles, heavy imports, size, docstrings
and ``__all__``.

A rule is a function from modules to complaints, one line for each offence with the file's name.
Each rule is applied to all modules at once, and to made-up ones that break it.
"""

import ast
import re
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# -- the design, as data --------------------------------------------------------------------------

MAY_IMPORT = {
    "motdiff": {"motdiff"},  # motion is useful without shutters and codes
    "hw": {"hw"},  # a shutter is driven without numpy, photos or theory
    "cep": {"cep", "motdiff", "hw"},
    "lab": {"lab", "cep", "motdiff", "hw"},  # trainings outside the wheel
}

HEAVY = {"torch", "matplotlib", "skimage", "numba"}
"""Half a second to seconds to import: inside the function that needs them, or in a module listed
in pyproject.toml."""

LISTED = {"torch", "numba"}
"""A listed module may import one of these at its top: a network's module torch, that of the
compiled loops numba."""

NEVER = {"torchvision", "matplotlib.pyplot", "pylab"}
"""pyplot keeps global state; torchvision is no dependency."""

UNPICKLING = {
    "pickle",
    "cloudpickle",
    "dill",
    "shelve",
    "marshal",
    "joblib.load",
    "joblib.Memory",
    "torch.load",
    "yaml",
}
RUNNING = {
    "eval",
    "exec",
    "torch.load",
    "torch.export.load",
    "torch.jit.load",
    "torch.package.PackageImporter",
}
UNSAFE_OPTIONS = {("allow_pickle", "True"), ("weights_only", "False")}

COMMANDS = "cep/commands/"
LIGHT = {
    "cep.restoration.registry",
    "cep.search.chip_count",
    "cep.search.objectives",
    "hw.export",
    "motdiff.estimators.method",
    "motdiff.estimators.registry",
}
"""Modules that import what they need within their functions."""
COMMANDS_MAY_IMPORT = {
    "__future__",
    "collections",
    "contextlib",
    "dataclasses",
    "functools",
    "inspect",
    "os",
    "pathlib",
    "re",
    "shutil",
    "signal",
    "sys",
    "textwrap",
    "time",
    "traceback",
    "typing",
    "typer",
    "cep",
}
"""At the top of a command's module: `cep --help` answers in under half a second."""


@cache
def listed_modules():
    """Patterns of the modules that may import torch or numba at their top: where ruff's TID253 is
    ignored."""
    ignores = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["lint"][
        "per-file-ignores"
    ]
    patterns = {}
    for glob, rules in ignores.items():
        if glob == "lab/studies/**":
            continue  # scripts
        if "TID253" in rules and glob.startswith(tuple(f"{package}/" for package in MAY_IMPORT)):
            for part in _alternatives(glob):
                patterns[part] = re.compile(
                    re.escape(part).replace(r"\*\*", ".*").replace(r"\*", "[^/]*") + "$"
                )
    return patterns


def _alternatives(glob):
    inner = re.fullmatch(r"(.*)\{(.*)\}(.*)", glob)
    return [f"{inner[1]}{choice}{inner[3]}" for choice in inner[2].split(",")] if inner else [glob]


# -- modules --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Module:
    """A source file: its path from the root, and its text."""

    path: str
    source: str = field(repr=False)

    @property
    def package(self):
        return self.path.split("/")[0]

    @property
    def dotted(self):
        return self.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    @property
    def name(self):
        return self.path.rpartition("/")[2]

    @property
    def public(self):
        return self.name == "__init__.py" or not self.name.startswith("_")

    @cached_property
    def tree(self):
        return ast.parse(self.source)

    @cached_property
    def imports(self):
        """Every absolute module name that is imported anywhere, `from a import b` as both a and
        a.b."""
        return frozenset(imported(ast.walk(self.tree)))

    @cached_property
    def top_imports(self):
        """Those that run on import."""
        return frozenset(imported(runtime_top_level(self.tree)))


def imported(nodes):
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def runtime_top_level(tree):
    """Yield the statements that run on import: class bodies and try blocks too, TYPE_CHECKING
    blocks not."""
    pending = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            pending.extend(
                child
                for child in ast.iter_child_nodes(node)
                if isinstance(child, ast.stmt | ast.excepthandler)
            )


def root_of(name):
    return name.split(".")[0]


def within(name, names):
    return any(name == other or name.startswith(f"{other}.") for other in names)


# -- the rules ------------------------------------------------------------------------------------


def imports_point_downward(modules):
    """Motdiff and hw import neither cep nor each other; nothing imports lab."""
    for module in modules:
        upward = {root_of(name) for name in module.imports} & set(MAY_IMPORT) - MAY_IMPORT[
            module.package
        ]
        for package in sorted(upward):
            yield f"{module.path}: imports {package}"


def imports_are_absolute(modules):
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                yield f"{module.path}:{node.lineno}: relative import: write the whole name"


def no_import_circle(modules):
    """No module needs itself before it is loaded; one circle is named for each import to be taken
    out."""
    names = {module.dotted: module for module in modules}
    graph = {name: (module.top_imports & set(names)) - {name} for name, module in names.items()}
    while True:
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            circle = error.args[1][::-1]  # each imports the next
            graph[circle[0]] -= {circle[1]}
            yield f"import circle: {' -> '.join(names[name].path for name in circle)}"
        else:
            return


def heavy_imports_are_in_functions_or_listed_modules(modules):
    for module in modules:
        if module.path.startswith("lab/studies/"):
            continue  # scripts
        heavy = {root_of(name) for name in module.top_imports} & HEAVY
        listed = any(pattern.match(module.path) for pattern in listed_modules().values())
        if listed and len(heavy & LISTED) == 1:
            heavy -= LISTED
        for library in sorted(heavy):
            yield (
                f"{module.path}: imports {library} at its top: import it inside the function that"
                " needs it"
            )


def listed_modules_need_their_listing(modules):
    """An allowance that is no longer needed must go."""
    for listed, pattern in listed_modules().items():
        if not any(
            pattern.match(module.path) and LISTED & {root_of(name) for name in module.top_imports}
            for module in modules
        ):
            yield (
                f"pyproject.toml: TID253 is ignored for {listed}, where no module imports torch or"
                " numba at its top"
            )


def one_module_wraps_numba(modules):
    wrappers = sorted(module.path for module in modules if "numba" in map(root_of, module.imports))
    if len(wrappers) > 1:
        yield f"{', '.join(wrappers)}: import numba, which one module wraps for all"


def some_libraries_are_never_imported(modules):
    for module in modules:
        for name in sorted(name for name in module.imports if within(name, NEVER)):
            yield f"{module.path}: imports {name}"


def no_file_runs_code(modules):
    """A pickle, however it is loaded, runs code of whoever wrote the file; so does text that is
    evaluated."""
    for module in modules:
        for name in sorted(name for name in module.imports if within(name, UNPICKLING)):
            yield f"{module.path}: imports {name}, which runs code that files hold"
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call) and (call := ast.unparse(node.func)) in RUNNING:
                yield f"{module.path}:{node.lineno}: {call} runs code that files hold"
            if (
                isinstance(node, ast.keyword)
                and (node.arg, ast.unparse(node.value)) in UNSAFE_OPTIONS
            ):
                yield f"{module.path}:{node.value.lineno}: {node.arg} runs code that files hold"


def commands_start_light(modules):
    for module in modules:
        if not module.path.startswith(COMMANDS):
            continue
        own = COMMANDS.strip("/").replace("/", ".")
        for name in sorted(module.top_imports):
            if within(name, {own, *LIGHT}):
                continue
            if root_of(name) not in COMMANDS_MAY_IMPORT or name.startswith("cep."):
                yield f"{module.path}: imports {name} at its top: import it inside the command"


def public_modules_have_docstrings(modules):
    for module in modules:
        if module.public and not ast.get_docstring(module.tree):
            yield f"{module.path}: has no docstring"


def front_doors_alone_list_what_they_offer(modules):
    """A package that offers names lists each once, in __all__, and all of it exists."""
    for module in modules:
        assignments = [
            node.value
            for node in module.tree.body
            if isinstance(node, ast.Assign)
            and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
        ]
        if module.name != "__init__.py":
            if assignments:
                yield f"{module.path}: has __all__, which is for packages"
            continue
        if not any(
            isinstance(node, ast.ImportFrom) and node.module != "__future__"
            for node in module.tree.body
        ):
            continue
        if len(assignments) != 1:
            yield f"{module.path}: has {len(assignments) or 'no'} __all__"
            continue
        offered = ast.literal_eval(assignments[0])
        defined = _defined(module.tree)
        if "__getattr__" in defined:  # names made on demand: the tests of that module ask for each
            continue
        for name in sorted(set(offered) - defined):
            yield f"{module.path}: __all__ names {name}, which does not exist"
        for name in sorted(name for name in set(offered) if offered.count(name) > 1):
            yield f"{module.path}: __all__ names {name} twice"


def _defined(tree):
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names |= {alias.asname or alias.name for alias in node.names}
    return names


RULES = {
    rule.__name__: rule
    for rule in (
        imports_point_downward,
        imports_are_absolute,
        no_import_circle,
        heavy_imports_are_in_functions_or_listed_modules,
        listed_modules_need_their_listing,
        one_module_wraps_numba,
        some_libraries_are_never_imported,
        no_file_runs_code,
        commands_start_light,
        public_modules_have_docstrings,
        front_doors_alone_list_what_they_offer,
    )
}

# -- applied to the source ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def modules():
    return [
        Module(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
        for package in MAY_IMPORT
        for path in sorted((ROOT / package).rglob("*.py"))
    ]


def test_every_package_has_modules(modules):
    counts = Counter(module.package for module in modules)
    assert set(counts) == set(MAY_IMPORT)
    assert min(counts.values()) > 10
    assert any(module.path.startswith(COMMANDS) for module in modules)


@pytest.mark.parametrize("rule", RULES)
def test_the_source_keeps_the_rule(rule, modules):
    complaints = list(RULES[rule](modules))
    assert not complaints, "\n".join(["", *complaints])


# -- applied to offenders -------------------------------------------------------------------------

DOC = '"""A module."""\n'
MADE_UP = {  # a file called bad breaks the rule, a file called good keeps it
    "imports_point_downward": {
        "motdiff/bad.py": "def f():\n    import hw.program\n",
        "hw/bad.py": "from cep.optics import code\n",
        "cep/good.py": "import hw, motdiff.trajectory\n",
    },
    "imports_are_absolute": {
        "cep/bad.py": "def f():\n    from . import good\n",
        "cep/good.py": "from cep import bad\n",
    },
    "no_import_circle": {
        "cep/bad1.py": "import cep.bad2\n",
        "cep/bad2.py": "try:\n    from cep import bad3\nexcept ImportError:\n    pass\n",
        "cep/bad3.py": "class C:\n    from cep.bad1 import x\n",
        "cep/good1.py": "import cep.good2\nimport cep.bad1\n",
        "cep/good2.py": "def f():\n    import cep.good1\n",
    },
    "heavy_imports_are_in_functions_or_listed_modules": {
        "cep/bad1.py": "try:\n    import os\nexcept ImportError:\n    import skimage.io\n",
        "cep/bad2.py": "class A:\n    from matplotlib import ticker\n",
        "cep/good1.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch\n",
        "cep/good2.py": "import torch_like\ndef f():\n    import torch\n",
        "cep/bad3.py": "import numba\n",
    },
    "one_module_wraps_numba": {
        "cep/bad1.py": "import numba\n",
        "cep/bad2.py": "def f():\n    from numba import njit\n",
    },
    "some_libraries_are_never_imported": {
        "cep/bad1.py": "def f():\n    import matplotlib.pyplot as plt\n",
        "cep/bad2.py": "def f():\n    from matplotlib import pyplot\n",
        "cep/bad3.py": "import torchvision.ops\n",
        "cep/good.py": "def f():\n    import matplotlib.figure\n",
    },
    "no_file_runs_code": {
        "cep/bad1.py": "from pickle import loads\n",
        "motdiff/bad2.py": "import torch\ndef f(x):\n    return torch.export.load(x)\n",
        "cep/bad3.py": "import numpy as np\ndef f(x):\n    return np.load(x, allow_pickle=True)\n",
        "hw/bad4.py": "def f(x):\n    return eval(x)\n",
        "cep/good.py": (
            "import numpy as np\ndef f(x, network):\n    network.eval()\n    return np.load(x)\n"
        ),
    },
    "commands_start_light": {
        f"{COMMANDS}bad1.py": "import numpy\n",
        f"{COMMANDS}bad2.py": "from cep.optics.code import ShutterCode\n",
        f"{COMMANDS}good.py": (
            "import os.path\nfrom cep.commands import common\ndef f():\n    import numpy\n"
        ),
        "cep/good.py": "import numpy\n",
    },
    "public_modules_have_docstrings": {
        "cep/bad.py": "x = 1\n",
        "cep/bad/__init__.py": "",
        "cep/good.py": DOC,
        "cep/_good.py": "x = 1\n",
    },
    "front_doors_alone_list_what_they_offer": {
        "cep/bad1.py": DOC + "__all__ = ['f']\ndef f():\n    pass\n",
        "cep/bad2/__init__.py": DOC + "from cep.good1 import f, g\n__all__ = ['f', 'h']\n",
        "cep/bad3/__init__.py": DOC + "from cep.good1 import f\n__all__ = ['f', 'f']\n",
        "cep/bad4/__init__.py": DOC + "from cep.good1 import f\n",
        "cep/good1.py": DOC + "X = 1\nasync def f():\n    pass\n",
        "cep/good2/__init__.py": DOC,
        "cep/good3/__init__.py": DOC + "from cep.good1 import f\n__all__ = ['f']\n",
        "cep/good4/__init__.py": DOC
        + "import os\n__all__ = ['f']\ndef __getattr__(name):\n    pass\n",
        "cep/good2/__main__.py": DOC + "print()\n",
    },
}


@pytest.mark.parametrize("rule", MADE_UP)
def test_the_rule_names_every_offender_and_nobody_else(rule):
    complaints = "\n".join(RULES[rule]([Module(*file) for file in MADE_UP[rule].items()]))
    assert [path for path in MADE_UP[rule] if path in complaints] == [
        path for path in MADE_UP[rule] if "bad" in path
    ]


def test_every_rule_is_tried_on_offenders():
    assert set(RULES) == {*MADE_UP, "listed_modules_need_their_listing"}


def test_listed_modules_may_import_torch_as_long_as_they_do():
    paths = [pattern.replace("**", "deep/module.py") for pattern in listed_modules()]
    users = [Module(path, "import torch\n") for path in paths]
    assert not list(heavy_imports_are_in_functions_or_listed_modules(users))
    assert not list(listed_modules_need_their_listing(users))
    others = [Module(path, "import skimage\n") for path in paths]
    assert len(list(heavy_imports_are_in_functions_or_listed_modules(others))) == len(paths)
    assert len(list(listed_modules_need_their_listing(others))) == len(paths)
    both = [Module(path, "import numba, torch\n") for path in paths]
    assert len(list(heavy_imports_are_in_functions_or_listed_modules(both))) == 2 * len(paths)
