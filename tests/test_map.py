"""The map and the guide of the house hold against the tree: folders, contracts, and every name in backticks.

Read with ast, so that a name that moved is found missing without importing anything heavy.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import keyword
import re
from collections.abc import Iterator
from functools import cache

import pytest

from .sources import PACKAGES, ROOT

MAP, GUIDE = "docs/map.md", "CONTRIBUTING.md"
SOURCES = (*PACKAGES, "tests", "case_studies")
COMMANDS = {"python", "ruff", "mypy", "bash", "pip", "loadid"}  # first words of lines for a shell
OUTSIDE = ("../", ".", "@", "[", "--", '"')  # options, decorators, suffixes, places beside the project
NOT_OURS = {"mypy", "LOADID_DATA", "eval"}  # a tool, a variable of the environment, a thing that is forbidden
FILE = re.compile(r"[\w.<>*/-]+\.(py|md|toml|csv|ext)|[\w.<>/-]+/(?:[\w-]+)?")
FOLDER = re.compile(r"- `([\w/]+)/` \S.*")
ROW = re.compile(r"\| `(\w+)[^`]*` \|")
NAMED_IN = re.compile(r"`(\w+)(?:\([^`]*\))?`(?: (?:and|or) `(\w+)`)?,? (?:of |in |\()`([\w/]+\.py)`")
DEFINED = re.compile(r"\b(?:def|class) (\w+)|^[ ]*(?:self\.)?(\w+) ?[:=]|[(,][ ]?\*{0,2}(\w+) ?[:=]", re.MULTILINE)


# -- reading the two texts ---------------------------------------------------------------------------------------------
def text_of(name: str) -> str:
    """A file of the project without its blocks of code, and with every sentence on one line."""
    lines = (ROOT / name).read_text("utf-8").splitlines()
    kept, fenced = [], False
    for line in lines:
        fenced ^= line.startswith("```")
        kept.append(
            "" if fenced or line.startswith(("```", "    python", "    ruff", "    mypy", "    bash")) else line
        )
    return "\n".join(kept)


def section(text: str, title: str) -> str:
    """What stands under a heading of the second order."""
    return text.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def quoted(text: str) -> list[str]:
    """Everything in single backticks, line ends taken for spaces."""
    return [" ".join(span.split()) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)]


# -- what the tree holds -----------------------------------------------------------------------------------------------
@cache
def files() -> frozenset[str]:
    """Every file of the project that is not hidden, from its root, and every folder with a slash at its end."""
    found = {path.relative_to(ROOT) for folder in (*SOURCES, "docs") for path in (ROOT / folder).rglob("*.*")}
    found |= {path.relative_to(ROOT) for path in ROOT.glob("*.*")}
    kept = {path for path in found if path.suffix != ".pyc" and path.name != "__pycache__"}
    folders = {f"{parent}/" for path in kept for parent in path.parents}
    return frozenset({path.as_posix() for path in kept} | folders)


@cache
def names_in(path: str) -> frozenset[str]:
    """What a file defines anywhere: functions, classes, parameters, variables, attributes."""
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.id if isinstance(node, ast.Name) else node.attr)
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names if node.level}
    return frozenset(found)


@cache
def words() -> frozenset[str]:
    """Names that some file gives to anything, and those of all modules and folders."""
    sources = [path for path in files() if path.endswith(".py")]
    stems = {part.removesuffix(".py") for path in sources for part in path.split("/")}
    texts = ((ROOT / path).read_text("utf-8") for path in sources)
    known = {name for text in texts for names in DEFINED.findall(text) for name in names}
    return frozenset(known | stems | set(dir(builtins)) | set(keyword.kwlist) | NOT_OURS)


def exists(path: str) -> bool:
    """Whether a path, or its end, or a pattern with <name> in it, fits a file or a folder of the project."""
    pattern = re.compile("(.*/)?" + re.escape(path).replace("<", "\0<").replace(r"\*", "[^/]*"))
    pattern = re.compile(re.sub("\0<[^>]*>", "[^/]+", pattern.pattern))
    return any(pattern.fullmatch(file) for file in files())


def defined(name: str) -> bool:
    """Whether a dotted name of the project is a module, or is defined in the module that its first parts name."""
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        stem = "/".join(parts[:n])
        module = next((f for f in (f"{stem}.py", f"{stem}/__init__.py") if f in files()), None)
        if module is not None:
            rest = parts[n:]
            lazy = n == 1 and bool(rest) and rest[0] in importlib.import_module(parts[0]).__all__
            return not rest or lazy or all(part in names_in(module) for part in rest)
    return False


def missing(span: str) -> Iterator[str]:
    """What a piece of quoted code names and the project does not hold."""
    first = span.split()[0]
    if span.startswith(OUTSIDE):
        return
    if first in COMMANDS and first != span:
        named = re.findall(r"-m ((?:tests|case_studies)[\w.]*)", span)
        yield from (name for name in named if not defined(name))
    elif FILE.fullmatch(span):
        if not exists(span) and not exists(f"{span}/"):
            yield span
    else:
        code = re.sub(r"(\"[^\"]*\"|'[^']*')", "", span)
        for name in re.findall(r"[A-Za-z_][\w.]*\w|[A-Za-z_]", code):
            own = name.split(".")[0] in SOURCES and "." in name
            if not (defined(name) if own else all(part in words() for part in name.split("."))):
                yield name


# -- the tests ---------------------------------------------------------------------------------------------------------
def test_every_folder_has_one_line_in_the_map() -> None:
    lines = [line for line in section(text_of(MAP), "Folders").splitlines() if line.startswith("- ")]
    unread = [line for line in lines if not FOLDER.fullmatch(line)]
    assert not unread, f"{MAP}, Folders: write these as '- `folder/` what it holds':\n" + "\n".join(unread)
    listed = [line.split("`")[1].rstrip("/") for line in lines]
    there = {f.rpartition("/")[0] for f in files() if f.endswith(".py") and f.split("/")[0] in PACKAGES}
    wrong = [f"{MAP}, Folders: add a line for {folder}/" for folder in sorted(there - set(listed))]
    wrong += [f"{MAP}, Folders: no Python file lies in {folder}/: take its line out" for folder in listed
              if folder not in there]  # fmt: skip
    wrong += [f"{MAP}, Folders: {folder}/ has more than one line" for folder in sorted(there)
              if listed.count(folder) > 1]  # fmt: skip
    assert not wrong, "\n".join(wrong)


def contracts() -> list[tuple[str, list[str]]]:
    """The class that each contract names in its heading, and the members that its table lists."""
    parts = re.split(r"\n### ", section(text_of(MAP), "The two contracts"))[1:]
    return [(quoted(part.splitlines()[0])[0], ROW.findall(part)) for part in parts]


def test_there_are_two_contracts() -> None:
    assert [name.rpartition(".")[2] for name, _ in contracts()] == ["Model", "RegularizationPath"]


@pytest.mark.parametrize(("name", "members"), contracts(), ids=lambda x: x if isinstance(x, str) else "")
def test_what_a_contract_lists_is_there(name: str, members: list[str]) -> None:
    module, _, kind = name.rpartition(".")
    contract = getattr(importlib.import_module(module), kind)
    wrong = [member for member in members if not (hasattr(contract, member) or member in contract.__annotations__)]
    assert len(members) > 5
    assert not wrong, f"{MAP}, The two contracts: {name} has no {', '.join(wrong)}: mend the table"


@pytest.mark.parametrize("name", [MAP, GUIDE])
def test_every_quoted_name_exists(name: str) -> None:
    stale = [f"{name}: `{span}`: no {what} in the project" for span in quoted(text_of(name)) for what in missing(span)]
    assert not stale, "say where they are now:\n" + "\n".join(dict.fromkeys(stale))


@pytest.mark.parametrize("name", [MAP, GUIDE])
def test_a_name_is_in_the_file_that_is_given_with_it(name: str) -> None:
    wrong = []
    for one, two, path in NAMED_IN.findall(" ".join(text_of(name).split())):
        places = [f for f in files() if f == path or f.endswith(f"/{path}")]
        wrong += [f"{name}: `{what}` is not in {path}" for what in (one, two)
                  if what and not any(what in names_in(place) for place in places)]  # fmt: skip
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "span",
    ["loadid/inverse/no_such.py", "no_such/", "loadid.no_such", "structures.no_such.Model", "no_such_function(path)",
     "NO_SUCH", "python -m tests.benchmarks.no_such", "loadid/<name>/no_such.py"],
)  # fmt: skip
def test_a_stale_name_is_seen(span: str) -> None:
    assert list(missing(span))


@pytest.mark.parametrize(
    "span",
    ["tests/test_map.py", "test_map.py", "loadid/", "loadid.InputError", "structures.errors.InputError",
     "gather(record, model)", "RULES", "python -m pytest", "tests/test_<name>.py", "str -> list[int]", "None"],
)  # fmt: skip
def test_a_name_that_is_there_passes(span: str) -> None:
    assert list(missing(span)) == []
