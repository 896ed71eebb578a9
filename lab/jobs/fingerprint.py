"""Fingerprints of source code: of a module with the project's modules that it imports, and of the
whole project.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_OURS = ("cep", "motdiff", "lab")
_COUNTING = (".py", ".safetensors", ".toml")


def source_version(
    modules: Iterable[str], *, alone: Iterable[str] = (), files: Iterable[Path] = ()
) -> str:
    """Fingerprint of modules: 16 hexadecimal digits, independent of comments, docstrings and
    layout.

    Parameters
    ----------
    modules : iterable of names
        Modules, with every module of the project that they import, recursively.
    alone : iterable of names
        Modules whose imports do not count.
    files : iterable of Path
        Such as weights.

    Raises
    ------
    ValueError
        If there is no such module.
    OSError
        If a file cannot be read.
    """
    visited: set[str] = set()
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name not in visited:
            visited.add(name)
            waiting += _imports(name)
    digest = hashlib.sha256()
    for name in sorted(visited | set(alone)):
        digest.update(f"{name}:{_meaning(name)};".encode())
    for path in files:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


@cache
def all_sources() -> str:
    """Fingerprint of the project's code, weights and settings: 64 hexadecimal digits.

    Read once: it describes the loaded modules, not a later installation.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    digest = hashlib.sha256()
    for package in _OURS:
        init = _file(package)
        if init is None:
            continue  # the laboratory is not installed
        files = (
            path for path in init.parent.rglob("*") if path.suffix in _COUNTING and path.is_file()
        )
        for path in sorted(files, key=Path.as_posix):  # the same order on every system
            name = f"{package}/{path.relative_to(init.parent).as_posix()}"
            digest.update(f"{name}:{hashlib.sha256(path.read_bytes()).hexdigest()};".encode())
    return digest.hexdigest()


@cache
def _file(name: str) -> Path | None:
    """Return the file of a module, None where the name is an attribute of a module."""
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:
        return None
    return (
        Path(spec.origin)
        if spec is not None and spec.has_location and spec.origin is not None
        else None
    )


@cache
def _tree(name: str) -> ast.Module | None:
    """Return the syntax of a module; None of one that is compiled, as a user's may be."""
    path = _source(name)
    return ast.parse(path.read_text(encoding="utf-8")) if path.suffix == ".py" else None


def _source(name: str) -> Path:
    path = _file(name)
    if path is None:
        raise ValueError(f"module: there is no {name}, or it has no file")
    return path


@cache
def _imports(name: str) -> frozenset[str]:
    """Names of the project's modules that a module imports, also within functions."""
    tree = _tree(name)
    names = () if tree is None else _imported(tree)
    return frozenset(
        module for module in names if module.split(".")[0] in _OURS and _file(module) is not None
    )


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            # a name imported from a package may be a module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def _meaning(name: str) -> str:
    if (syntax := _tree(name)) is None:
        return hashlib.sha256(_source(name).read_bytes()).hexdigest()
    tree = ast.parse(ast.unparse(syntax))
    for node in ast.walk(tree):
        if isinstance(
            node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        ) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()
