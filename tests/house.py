"""How large the house is and how it hangs together: `python -m tests.house` prints the table.

Everything but the files that are entered is read with ast; those are counted while a short record is inverted, and
while ``loadid identify`` makes a report of it.
"""

from __future__ import annotations

import ast
import contextlib
import io
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from .sources import PACKAGES, ROOT, imported, modules, parsed, walked, within

MOST_FILES, MOST_PARAMETERS = 20, 10
PUBLIC = (
    "structures", "structures.bases", "structures.errors", "structures.files", "structures.shape_sensing",
    "structures.units",
    "loadid", "loadid.codes", "loadid.constraints", "loadid.datasets", "loadid.design", "loadid.fullfield",
    "loadid.generate", "loadid.paths", "loadid.priors", "loadid.settings", "loadid.sources", "loadid.validate",
    "loadid.vibration",
    "tactile", "tactile.datasets", "tactile.design", "tactile.generate", "tactile.live", "tactile.material",
    "tactile.metrics", "tactile.vision",
)  # fmt: skip
HEAVY = ("numpy", "scipy", "matplotlib", "h5py", "numba", "casadi", "filterpy", "clarabel", "cv2", "pyuff", "skfem")


@cache
def trees() -> dict[str, ast.Module]:
    """Module name -> its tree."""
    return {name: parsed(path) for name, path in modules(*PACKAGES)}


def lines() -> int:
    """Source lines of the three packages, blank ones and comments included."""
    return sum(len(path.read_text("utf-8").splitlines()) for _, path in modules(*PACKAGES))


def crowded() -> dict[str, int]:
    """Folders with more files than `MOST_FILES`."""
    count = Counter(str(path.parent.relative_to(ROOT)) for _, path in modules(*PACKAGES))
    return {folder: n for folder, n in count.most_common() if n > MOST_FILES}


@cache
def graph() -> dict[str, set[str]]:
    """Module -> modules of the house that it loads, at its top or inside a function; for types alone does not count.

    The doors of the three packages are left out: they name what they offer, and load it when it is asked for.
    """
    names = {name for name, _ in modules(*PACKAGES)} - {f"{package}.__init__" for package in PACKAGES}
    return {name: _loaded(trees()[name], name, names) - {name} for name in names}


def _loaded(tree: ast.Module, name: str, names: set[str]) -> set[str]:
    """Which of `names` a module loads when it runs: a submodule that is asked for, not the package it lies in."""
    found: set[str] = set()
    for node in _running(tree):
        for base, *asked in imported(node, name):
            for full in (f"{base}.{one}" for one in asked) if asked else [base]:
                places = (full, f"{full}.__init__", base, f"{base}.__init__")
                found |= {next((place for place in places if place in names), name)}
    return found


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes outside ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and _last(node.test) == "TYPE_CHECKING"):
            yield node
            yield from _running(node)


def circles() -> list[set[str]]:
    """Groups of modules that load each other, directly or not (strongly connected components)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    edges = graph()
    names = sorted(edges)
    place = {name: i for i, name in enumerate(names)}
    pairs = [(place[a], place[b]) for a in names for b in edges[a]]
    rows, columns = zip(*pairs, strict=True)
    matrix = csr_array((np.ones(len(pairs)), (rows, columns)), shape=(len(names), len(names)))
    _, label = connected_components(matrix, connection="strong")
    groups = [{names[i] for i in np.flatnonzero(label == k)} for k in range(label.max() + 1)]
    return sorted((g for g in groups if len(g) > 1), key=len, reverse=True)


def lazy() -> int:
    """Imports of the house's own modules inside functions."""
    inside = 0
    for tree in trees().values():
        for function in _functions(tree):
            for node in ast.walk(function):
                own = isinstance(node, ast.ImportFrom) and (
                    node.level > 0 or (node.module or "").split(".")[0] in PACKAGES
                )
                inside += own or (
                    isinstance(node, ast.Import) and any(within(a.name, p) for a in node.names for p in PACKAGES)
                )
    return inside


def public_names() -> int:
    """Names in ``__all__`` of the public modules, each once, and of modules that are public by their name alone."""
    offered = {name for module in PUBLIC for name in import_module(module).__all__}
    named = {
        f"{name}.{node.name}"
        for name, tree in trees().items()
        if not any(part.startswith("_") and part != "__init__" for part in name.split("."))
        and name.removesuffix(".__init__") not in PUBLIC
        for node in tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
    }
    return len(offered) + len(named)


def repeated_classes() -> dict[str, int]:
    """Class names that are defined more than once."""
    count = Counter(n.name for tree in trees().values() for n in walked(tree) if isinstance(n, ast.ClassDef))
    return {name: n for name, n in count.most_common() if n > 1}


@cache
def kinds(*roots: str) -> frozenset[str]:
    """Classes of the house that derive from some classes, by their names; without these."""
    bases: dict[str, set[str]] = {}
    for tree in trees().values():
        for node in walked(tree):
            if isinstance(node, ast.ClassDef):
                bases.setdefault(node.name, set()).update(b for x in node.bases if (b := _last(x)))
    found: set[str] = set()
    while more := {c for c, of in bases.items() if of & ({*roots} | found)} - found:
        found |= more
    return frozenset(found)


def probed(tree: ast.Module) -> Iterator[int]:
    """Lines on which code asks what a model or a path is, where the contract would answer.

    Those are `getattr` and `hasattr` of something called a model or a path; `isinstance` with one of their kinds,
    whatever the thing is called; and a method compared with that of `Model`. Whether a thing is a `Model` at all may
    be asked.
    """
    own = {node.name for node in walked(tree) if isinstance(node, ast.ClassDef)}
    special = kinds("Model", "RegularizationPath") - own
    for node in walked(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
            asked = node.func.id in ("getattr", "hasattr") and _last(node.args[0]) in ("model", "path")
            named = node.args[1:] if node.func.id == "isinstance" else []
            if asked or any(_last(x) in special for a in named for x in ast.walk(a) if isinstance(x, ast.expr)):
                yield node.lineno
        elif isinstance(node, ast.Compare) and "Model" not in own:
            sides = (node.left, *node.comparators)
            if any(isinstance(s, ast.Attribute) and _last(s.value) == "Model" for s in sides):
                yield node.lineno


def trespassed(tree: ast.Module) -> Iterator[int]:
    """Lines that use a private attribute which is not one of `self` or `cls`, nor of a class of this module."""
    nodes = list(walked(tree))
    own = {n.attr for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)}
    for one in (x for n in nodes if isinstance(n, ast.ClassDef) for x in n.body):
        if isinstance(one, ast.FunctionDef):
            own.add(one.name)
        elif isinstance(one, ast.Assign | ast.AnnAssign):
            own |= {n.id for n in ast.walk(one) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__"):
            above = isinstance(node.value, ast.Call) and _last(node.value.func) == "super"
            if _last(node.value) not in ("self", "cls") and not above and node.attr not in own:
                yield node.lineno


def places(found: Callable[[ast.Module], Iterator[int]]) -> list[str]:
    """Where the modules have what `found` finds, ``"loadid._results.report:12"``."""
    return [f"{name}:{line}" for name, tree in trees().items() for line in sorted(found(tree))]


def long_constructors() -> dict[str, int]:
    """Public classes whose constructor takes more than `MOST_PARAMETERS`."""
    found = {}
    for tree in trees().values():
        for node in walked(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                for made in node.body:
                    if isinstance(made, ast.FunctionDef) and made.name == "__init__":
                        count = len(made.args.args) + len(made.args.kwonlyargs) - 1
                        if count > MOST_PARAMETERS:
                            found[node.name] = count
    return found


def single_importers() -> int:
    """Modules that exactly one other loads."""
    count = Counter(b for loaded in graph().values() for b in loaded)
    return sum(n == 1 and not name.endswith("__init__") for name, n in count.items())


def entered(work: Callable[[], object]) -> tuple[int, int]:
    """Files and functions of the house that some work enters, the second time it runs."""
    work()
    files: set[str] = set()
    functions: set[tuple[str, int]] = set()

    def watch(frame, event, argument):  # type: ignore[no-untyped-def]
        name = frame.f_code.co_filename
        if event == "call" and any(name.startswith(str(ROOT / package)) for package in PACKAGES):
            files.add(name)
            functions.add((name, frame.f_code.co_firstlineno))

    sys.setprofile(watch)
    try:
        work()
    finally:
        sys.setprofile(None)
    return len(files), len(functions)


def deconvolution() -> Callable[[], object]:
    """One estimate of 300 samples."""
    from loadid import Deconvolution

    model, record = _simulated()
    return lambda: Deconvolution(model).estimate(record, dt=1e-3)


def identify() -> Callable[[], object]:
    """`loadid identify` from a CSV to a report."""
    from loadid.cli import main

    folder = Path(tempfile.mkdtemp())
    model, record = _simulated()
    model.save(folder / "model.h5")
    label = model.sensors[0].label
    table = np.column_stack([np.arange(len(record)) * 1e-3, record])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=f"time [s],{label} [m]", comments="")
    words = ["identify", str(folder / "log.csv"), "--model", str(folder / "model.h5"), "-o", str(folder / "out.h5"),
             "--report", str(folder / "out.html")]  # fmt: skip

    def run() -> None:
        for name in ("out.h5", "out.html"):
            (folder / name).unlink(missing_ok=True)
        with contextlib.redirect_stdout(io.StringIO()):
            code = main(words)
        if code:
            raise RuntimeError(f"loadid {' '.join(words)} ended with {code}")

    return run


def _simulated():  # type: ignore[no-untyped-def]
    from structures import ForwardModel, beams, damping, loads, sensors

    beam = beams.cantilever(
        length=0.6, section=beams.Section.rectangle(width=0.04, height=0.01), material=beams.materials.steel,
        elements=10, damping=damping.Modal(0.02),
    )  # fmt: skip
    model = ForwardModel(
        beam, [sensors.Displacement(at=0.6, direction="Z")], [loads.Point(at=0.5, direction="Z")], modes=3
    )
    load = np.zeros((300, 1))
    load[100:120] = np.sin(np.pi * (np.arange(20)[:, None] + 0.5) / 20)
    clean = model.state_space(1e-3).simulate(load)
    return model, clean + 0.01 * clean.std() * np.random.default_rng(0).standard_normal(clean.shape)


def _functions(tree: ast.Module) -> Iterator[ast.AST]:
    for node in walked(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _last(node: ast.expr) -> str | None:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else None


def main() -> None:
    """Print the table."""
    rings, folders, twice, long = circles(), crowded(), repeated_classes(), long_constructors()
    rows = [
        ("modules of the three packages", len(list(modules(*PACKAGES)))),
        ("source lines", lines()),
        (f"folders with more than {MOST_FILES} files", f"{len(folders)}: {folders}"),
        ("files / functions entered, Deconvolution.estimate", "{} / {}".format(*entered(deconvolution()))),
        ("files / functions entered, identify CSV to report", "{} / {}".format(*entered(identify()))),
        ("import circles, lazy ones included / modules in them", f"{len(rings)} / {sum(map(len, rings))}"),
        ("imports of own modules inside functions", lazy()),
        ("modules with one importer", single_importers()),
        (f"names in __all__ of {len(PUBLIC)} public modules", public_names()),
        ("getattr, hasattr, isinstance on models and paths", len(places(probed))),
        ("private attributes of another object", len(places(trespassed))),
        ("class names defined more than once", f"{len(twice)}: {', '.join(twice)}"),
        (f"constructors above {MOST_PARAMETERS} parameters", f"{len(long)}: {long}"),
    ]
    for name, value in rows:
        print(f"{name:56s}{value}")


if __name__ == "__main__":
    main()
