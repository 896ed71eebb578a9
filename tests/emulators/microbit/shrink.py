"""Python source made small for a board of 16 kB, and cut into pieces that its compiler has memory
for."""

from __future__ import annotations

import ast
from collections.abc import Iterator

__all__ = ["pieces"]


def pieces(*sources: str) -> list[str]:
    """Cut modules, as if they were one, into statements to be executed one after the other.

    Docstrings, annotations and named constants go, methods are put into their class later, and
    whatever the modules define themselves gets a short name: names stay in a board's memory for
    ever.
    """
    body = [
        node
        for source in sources
        for node in _without_docstring(ast.parse(source).body)
        if _is_for_the_board(node)
    ]
    constants: dict[str, int] = {}
    for node in body:
        constants |= _constants(node)
    rest = [node for node in body if not _constants(node)]
    shrinker = _Shrinker(constants, _short_names(rest))
    return [piece for node in rest for piece in _cut(shrinker.visit(node))]


class _Shrinker(ast.NodeTransformer):
    def __init__(self, constants: dict[str, int], names: dict[str, str]) -> None:
        self.constants = constants
        self.names = names
        self.locals: dict[str, str] = {}

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.body = _without_docstring(node.body) or [ast.Pass()]
        node.returns = None
        own = [argument.arg for argument in node.args.args]
        own += [
            part.id
            for part in ast.walk(node)
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
        ]
        self.locals = dict(zip(dict.fromkeys(own), "abcdefghijklmnop", strict=False))
        for argument in node.args.args:
            argument.arg, argument.annotation = self.locals[argument.arg], None
        self.generic_visit(node)
        self.locals = {}
        node.name = self.names.get(node.name, node.name)
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        node.body = _without_docstring(node.body)
        self.generic_visit(node)
        node.name = self.names.get(node.name, node.name)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.Attribute:
        self.generic_visit(node)
        node.attr = self.names.get(node.attr, node.attr)
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.constants:
            return ast.Constant(self.constants[node.id])
        node.id = self.locals.get(node.id) or self.names.get(node.id, node.id)
        return node


def _cut(node: ast.stmt) -> Iterator[str]:
    if not isinstance(node, ast.ClassDef):
        yield _narrow(node)
        return
    methods = [part for part in node.body if isinstance(part, ast.FunctionDef)]
    node.body = [part for part in node.body if part not in methods] or [ast.Pass()]
    yield _narrow(node)
    for method in methods:
        yield f"{_narrow(method)}\n{node.name}.{method.name} = {method.name}\ndel {method.name}"


def _narrow(node: ast.stmt) -> str:
    # One blank of indentation a level.
    lines = [
        (line.lstrip(" "), len(line) - len(line.lstrip(" ")))
        for line in ast.unparse(node).splitlines()
    ]
    return "\n".join(" " * (indent // 4) + text for text, indent in lines)


def _short_names(body: list[ast.stmt]) -> dict[str, str]:
    # What is defined at the top, in classes, and by assignment to attributes.
    found: dict[str, None] = {}
    for node in body:
        for part in ast.walk(node):
            if isinstance(part, ast.FunctionDef | ast.ClassDef):
                found[part.name] = None
            elif isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
                found[part.attr] = None
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        assigned = [part for part in inner if isinstance(part, ast.Assign)]
        found |= {ast.unparse(target): None for part in assigned for target in part.targets}
    short = (
        letter + end for end in ("", "a", "b", "c") for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
    )
    return {name: next(short) for name in found if not name.startswith("__")}


def _without_docstring(body: list[ast.stmt]) -> list[ast.stmt]:
    return body[1:] if ast.get_docstring(ast.Module(body, []), clean=False) is not None else body


def _is_for_the_board(node: ast.stmt) -> bool:
    if isinstance(node, ast.ImportFrom):
        return False  # of one of these modules, which are one here
    if isinstance(node, ast.If):
        return ast.unparse(node.test) != "TYPE_CHECKING"
    return not isinstance(node, ast.Assign) or ast.unparse(node.targets[0]) not in (
        "TYPE_CHECKING",
        "__all__",
    )


def _constants(node: ast.stmt) -> dict[str, int]:
    # `_A = 1` and `_A, _B = range(2)` at the top of a module.
    if not isinstance(node, ast.Assign) or isinstance(node.targets[0], ast.Attribute):
        return {}
    names = [name.strip() for name in ast.unparse(node.targets[0]).strip("()").split(",")]
    if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "range":
        values = range(*(ast.literal_eval(argument) for argument in node.value.args))
        return dict(zip(names, values, strict=True))
    if isinstance(node.value, ast.Constant) and isinstance(node.value.value, int):
        return {names[0]: node.value.value}
    return {}
