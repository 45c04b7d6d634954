"""Pages of the reference: every public name from its docstring, and every command from its parser."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from tests.house import PUBLIC

KINDS = ("classes", "functions", "values")


@dataclass(frozen=True)
class Name:
    """A public name: where it is asked for, what it is, and the full name under which it has its entry."""

    module: str
    name: str
    kind: str
    entry: str

    @property
    def full(self) -> str:
        """``"loadid.Deconvolution"``."""
        return f"{self.module}.{self.name}"


@cache
def modules() -> tuple[str, ...]:
    """Public modules, and those that a public module offers as names (``structures.beams``)."""
    found = list(PUBLIC)
    for name in PUBLIC:
        home = import_module(name)
        found += [f"{name}.{inner}" for inner in home.__all__ if isinstance(getattr(home, inner), ModuleType)]
    return tuple(dict.fromkeys(found))


def module(name: str) -> ModuleType:
    """A module by the name that users know it by."""
    package, _, inner = name.partition(".")
    found = import_module(package)
    return getattr(found, inner) if inner else found


@cache
def names() -> tuple[Name, ...]:
    """Every public name but modules; what several modules offer has its entry where it is offered first."""
    seen: dict[int, str] = {}
    found = []
    for home in modules():
        held = module(home)
        for name in _offered(held):
            thing = getattr(held, name)
            if isinstance(thing, ModuleType) or name == "__version__":
                continue
            kind = KINDS[0] if isinstance(thing, type) else KINDS[1] if hasattr(thing, "__name__") else KINDS[2]
            entry = seen.setdefault(id(thing), f"{home}.{name}") if kind != KINDS[2] else f"{home}.{name}"
            found.append(Name(home, name, kind, entry))
    return tuple(found)


def _offered(held: ModuleType) -> list[str]:
    """Names of a module: those of ``__all__``, else what is defined in it and not private."""
    if hasattr(held, "__all__"):
        return list(held.__all__)
    return [name for name, thing in vars(held).items()
            if not name.startswith("_") and getattr(thing, "__module__", "") == held.__name__]  # fmt: skip


def write(folder: Path) -> None:
    """A page for every module, one for the commands, and the page that lists them."""
    folder.mkdir(parents=True, exist_ok=True)
    for home in modules():
        (folder / f"{home}.rst").write_text(_page(home), "utf-8")
    (folder / "cli.md").write_text("\n".join(_commands()), "utf-8")


def _page(home: str) -> str:
    held = module(home)
    own = [name for name in names() if name.module == home]
    inner = [f"{home}.{n}" for n in getattr(held, "__all__", ()) if f"{home}.{n}" in modules()]
    lines = [home, "=" * len(home), "", _docstring(held), ""]
    if inner:
        lines += ["Modules: " + ", ".join(f":doc:`{name}`" for name in inner) + ".", ""]
    lines += _contents(own)
    for kind in KINDS:
        listed = [name for name in own if name.kind == kind and name.entry == name.full]
        if listed:
            lines += [kind.capitalize(), "-" * len(kind), ""]
        for name in sorted(listed, key=lambda one: one.name):
            lines += _entry(name)
    return "\n".join(lines) + "\n"


def _docstring(held: ModuleType) -> str:
    text = (held.__doc__ or "").strip()
    return re.sub(r"\n(?:Parameters|Notes)\n-+\n.*", "", text, flags=re.DOTALL)


def _contents(own: list[Name]) -> list[str]:
    """A table of the names, each with its first sentence."""
    lines = [".. list-table::", "   :class: names", ""]
    for name in sorted(own, key=lambda one: (one.kind, one.name)):
        said = "" if name.kind == KINDS[2] else (getattr(module(name.module), name.name).__doc__ or "").strip()
        first = " ".join(said.partition("\n\n")[0].split())
        lines += [f"   * - :py:obj:`{name.name} <{name.entry}>`", f"     - {first}"]
    return [*lines, ""] if own else []


def _entry(name: Name) -> list[str]:
    if name.kind == KINDS[0]:
        apart = "object, tuple, list, dict, str, float, int, Enum, Exception, BaseException, Model, Protocol"
        return [f".. autoclass:: {name.full}", "   :members:", f"   :inherited-members: {apart}", ""]
    if name.kind == KINDS[1]:
        return [f".. autofunction:: {name.full}", ""]
    return [f".. py:data:: {name.full}", "", "   Code of every guard and its title: :ref:`guard-codes`.", ""]


# -- the command line --------------------------------------------------------------------------------------------------
def _commands() -> Iterator[str]:
    from loadid import cli

    found = cli.parsers()
    yield "# Every command and option\n"
    yield f"{found[''].description} Made from the parsers of the commands; `loadid COMMAND --help` says the same.\n"
    shared = {option for action in found[""].arguments for option in action.option_strings}
    yield from _options(found[""].arguments, found[""])
    for name, parser in sorted(found.items()):
        if name:
            yield from _command(parser, f"loadid {name}", 2, shared)


def _command(parser: argparse.ArgumentParser, title: str, level: int, shared: set[str]) -> Iterator[str]:
    learn = getattr(parser, "learn", None)
    if learn is not None:
        learn()
    yield f"\n{'#' * level} {title}\n"
    yield f"{(parser.description or '').strip().capitalize()}.\n"
    actions = [a for a in parser._actions if not shared & set(a.option_strings) or a.nargs == argparse.PARSER]
    yield from _options(actions, parser)
    if parser.epilog:
        yield f"\n```text\n{parser.epilog.strip()}\n```\n"
    for action in actions:
        if action.nargs == argparse.PARSER:
            for name, inner in dict(action.choices or {}).items():
                yield from _command(inner, f"{title} {name}", level + 1, shared)


def _options(actions: Any, parser: argparse.ArgumentParser) -> Iterator[str]:
    rows = [row for action in actions if (row := _row(action, parser))]
    if rows:
        yield "| argument | what it is |\n|---|---|"
        yield from (f"| {name} | {said} |" for name, said in rows)


def _row(action: argparse.Action, parser: argparse.ArgumentParser) -> tuple[str, str] | None:
    if action.help in (None, argparse.SUPPRESS) or action.nargs == argparse.PARSER or "--help" in action.option_strings:
        return None
    formatter = parser._get_formatter()
    value = "" if action.nargs == 0 else formatter._format_args(action, action.dest.upper())
    text = formatter._expand_help(action)
    spelt = ", ".join(action.option_strings)
    name = f"`{spelt} {value}`" if spelt and value else f"`{spelt or value}`"
    return name.replace("|", r"\|"), _plain(text)


def _plain(text: str) -> str:
    """Help as it stands, whatever Markdown would make of it."""
    return re.sub(r"([\\`*_{}\[\]<>|$~^])", r"\\\1", " ".join(text.split()))
