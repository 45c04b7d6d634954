"""The source files of the project, and what they import, read with ast: nothing is executed."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("structures", "loadid", "tactile")
IMPORTERS = {"import_module", "__import__", "find_spec"}


def modules(*folders: str) -> Iterator[tuple[str, Path]]:
    """Dotted name and path of every Python file below some folders of the project."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            yield ".".join(parts), path


@cache
def parsed(path: Path) -> ast.Module:
    """A file as a tree, read once; nobody changes it."""
    return ast.parse(path.read_text("utf-8"))


@cache
def walked(tree: ast.AST) -> tuple[ast.AST, ...]:
    """Every node of a tree, as `ast.walk` gives them: walked once for all rules that ask."""
    return tuple(ast.walk(tree))


def imports(source: str | ast.Module, module: str) -> set[str]:
    """Dotted names that a module may load, wherever in its text: also inside functions, for types, and by name.

    ``from a import b`` gives ``a`` and ``a.b``, since `b` may be a module. A package is named ``a.__init__``.
    """
    found: set[str] = set()
    for node in walked(ast.parse(source) if isinstance(source, str) else source):
        for base, *asked in imported(node, module):
            found |= {base} | {f"{base}.{one}" for one in asked}
    return found


def imported(node: ast.AST, module: str) -> Iterator[tuple[str, ...]]:
    """What one node of a module's tree may load: a dotted name, and the names that are taken from it."""
    package = module.split(".")[:-1]
    if isinstance(node, ast.Import):
        yield from ((alias.name,) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield _absolute(node.module or "", node.level, package), *(alias.name for alias in node.names)
    elif isinstance(node, ast.Call) and called(node) in IMPORTERS and node.args:
        yield from ((name,) for name in _by_name(node.args[0], package))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _own(node.value):
        yield (node.value.split(":")[0],)  # tables such as {"Deconvolution": "loadid._families.deconvolution"}


def called(node: ast.Call) -> str:
    """Last name of what is called: ``inv`` of ``np.linalg.inv(A)``."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def within(name: str, package: str) -> bool:
    """Whether a dotted name is a package or lies in it."""
    return name == package or name.startswith(package + ".")


def _absolute(name: str, level: int, package: list[str]) -> str:
    if level == 0:
        return name
    base = package[: len(package) - level + 1]
    return ".".join([*base, *([name] if name else [])])


def _by_name(argument: ast.expr, package: list[str]) -> set[str]:
    """The module that a call such as ``import_module(".x")`` names, as far as its text says."""
    text = argument
    if isinstance(text, ast.JoinedStr) and text.values:
        text = text.values[0]
    if not (isinstance(text, ast.Constant) and isinstance(text.value, str)):
        return set()
    dots = len(text.value) - len(text.value.lstrip("."))
    return {_absolute(text.value[dots:].rstrip("."), dots, package)}


def _own(text: str) -> bool:
    head, _, rest = text.partition(":")
    parts = head.split(".")
    return (
        len(parts) > 1
        and parts[0] in (*PACKAGES, "case_studies")
        and all(p.isidentifier() for p in [*parts, rest or "x"])
    )
