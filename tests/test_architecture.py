"""The one-way street: structures <- loadid <- tactile <- case_studies, and inside loadid only doors open families.

And the two contracts: models and paths are asked, not probed, and nobody uses what is private to another.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from .house import PUBLIC, circles, graph, places, probed, trespassed
from .sources import PACKAGES, imported, imports, modules, parsed, walked, within

# package -> what nothing in it may import, at module level, inside a function, for a type or by name
FORBIDDEN = {
    "structures": ("loadid", "tactile", "case_studies", "tests"),
    "loadid": ("tactile", "case_studies", "tests"),
    "tactile": ("case_studies", "tests"),
    "loadid._inverse": (
        "loadid._families", "loadid._readers", "loadid._record", "loadid._quality", "loadid._results",
        "loadid.validate",
        "loadid._guards", "loadid._plots", "loadid.cli", "loadid._commands", "loadid._stream",
    ),
    "loadid._readers": ("loadid._families", "loadid._inverse", "loadid._results", "loadid._plots"),
    "loadid._plots": ("loadid._families", "loadid._readers", "loadid._inverse.svd", "loadid._inverse.convolution"),
    "loadid._families": (
        "loadid._readers", "loadid._plots", "loadid._results.report", "loadid.cli", "loadid._commands",
    ),
}  # fmt: skip
DOORS = (
    "loadid.__init__",
    "loadid.cli",
    "loadid._commands",
    "loadid._lab",
    "loadid._guide",
    "loadid._batch",
    "loadid._serve",
    "loadid._stream",
    "loadid.vibration",
)


def offences(module: str, source: str | ast.Module) -> list[str]:
    """What a module imports and may not."""
    loaded = sorted(imports(source, module))
    bad = [
        f"{module} imports {name}: {package} may not"
        for package, banned in FORBIDDEN.items()
        if within(module.removesuffix(".__init__"), package)
        for name in loaded
        if any(within(name, b) for b in banned)
    ]
    inside = any(within(module, door) for door in (*DOORS, "loadid._families"))
    if within(module, "loadid") and not inside:
        bad += [
            f"{module} imports {name}: only {', '.join(DOORS)} may"
            for name in loaded
            if within(name, "loadid._families")
        ]
    return bad


# what case studies still take from private modules; nothing is added here
INSIDE = {
    "contact_inversion": {"loadid._inverse.diagnosis.identifiability"},
    "bridge_crossing": {"loadid._inverse.gaussian.steady"},
    "impact_location": {"loadid._plots.choosing"},
    "riser_viv": {"loadid._families.field", "loadid._families.harmonic", "loadid._plots.fields"},
    "source_identification": {"loadid._results.functionals"},
}


def private(name: str) -> bool:
    """Whether a dotted name leads through an underscored module of the packages."""
    first, *rest = name.split(".")
    return first in PACKAGES and any(part.startswith("_") and part != "__init__" for part in rest)


@pytest.mark.parametrize(("module", "path"), list(modules("case_studies")))
def test_case_studies_import_what_is_public(module: str, path: Path) -> None:
    tree = parsed(path)
    taken = {found[0] for node in walked(tree) for found in imported(node, module) if private(found[0])}
    assert taken == INSIDE.get(path.stem, set())


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_module_says_what_it_offers(name: str) -> None:
    module = import_module(name)
    assert module.__all__, name
    assert [one for one in module.__all__ if not hasattr(module, one)] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_run_one_way(package: str) -> None:
    found = [offence for module, path in modules(package) for offence in offences(module, parsed(path))]
    assert not found, "\n".join(found)


def test_every_package_is_read() -> None:
    read = {module for module, _ in modules(*PACKAGES)}
    assert {"structures._model", "loadid._inverse.svd", "loadid._families.deconvolution", "tactile.__init__"} <= read


OFFENDERS = [
    ("structures._model", "import loadid"),
    ("structures._model", "def f():\n    from loadid._record import Record"),
    ("structures._model", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from loadid import Record"),
    ("structures._model", "import numpy, case_studies.impact_plate"),
    ("structures.__init__", "TABLE = {'Pad': 'tactile._pad.pad'}"),
    ("loadid._results.report", "from tactile import pad"),
    ("loadid.__init__", "import importlib\nimportlib.import_module('tactile._pad.pad')"),
    ("loadid._readers.csv_table", "from .._families import deconvolution"),
    ("loadid._inverse.rules", "from .._families.deconvolution import Deconvolution"),
    ("loadid._inverse.rules", "from .._results import estimate"),
    ("loadid._inverse.rules", "import importlib\nimportlib.import_module('.._readers', __package__)"),
    ("loadid._inverse.__init__", "from .._plots import plot"),
    ("loadid._plots", "def f():\n    from ._inverse.svd import SVDPath"),
    ("loadid.validate", "from ._families.deconvolution import Deconvolution"),
    ("loadid.validate", "from importlib import import_module\nname = 'loadid._families.deconvolution:Deconvolution'"),
    ("loadid._results.estimate", "from .. import _families"),
    ("tactile._pad.pad", "from case_studies import hammer_log"),
]
CLEAN = [
    ("structures._model", "import numpy as np\nfrom .errors import InputError\ntext = 'loadid turns it back'"),
    ("loadid.__init__", "TABLE = {'Deconvolution': 'loadid._families.deconvolution'}"),
    ("loadid._commands.identify", "from loadid._families.deconvolution import Deconvolution"),
    ("loadid.cli", "from ._families import deconvolution"),
    ("loadid._batch.run", "from .._families import deconvolution"),
    (
        "loadid._families.static",
        "from .data import gather\nfrom .._inverse.svd import SVDPath\nfrom ..estimate import LoadEstimate",
    ),
    (
        "loadid._inverse.svd",
        "from structures.errors import InputError\nfrom .path import Solution\nfrom . import rules",
    ),
    ("tactile._pad.pad", "from loadid import LoadEstimate\nfrom loadid._families.static import StaticInversion"),
]


def test_no_import_circles() -> None:
    """Also none that a function closes by loading late."""
    assert {name.split(".")[0] for name in graph()} == set(PACKAGES)
    assert [sorted(c) for c in circles()] == []


@pytest.mark.parametrize(("module", "source"), OFFENDERS)
def test_an_offending_import_is_caught(module: str, source: str) -> None:
    assert offences(module, source)


@pytest.mark.parametrize(("module", "source"), CLEAN)
def test_a_rightful_import_passes(module: str, source: str) -> None:
    assert offences(module, source) == []


# -- contracts -------------------------------------------------------------------------------------------------------
Found = Callable[[ast.Module], Iterator[int]]


@pytest.mark.parametrize("found", [probed, trespassed])
def test_contracts_are_kept(found: Found) -> None:
    assert places(found) == []


@pytest.mark.parametrize(
    ("found", "source"),
    [
        (probed, "getattr(model, 'basis', None)"),
        (probed, "hasattr(self.model, 'frf_variance')"),
        (probed, "getattr(posed.path, 'seen', None)"),
        (probed, "isinstance(given, MeasuredModel)"),
        (probed, "isinstance(x, int | tabulated.FrfModel)"),
        (probed, "isinstance(posed, (SVDPath, WindowedPath))"),
        (probed, "type(model).state_space is Model.state_space"),
        (trespassed, "model._columns"),
        (trespassed, "self.path._solved(lam)"),
        (trespassed, "parts._table(rows)"),
        (trespassed, "Factor._make(K)"),
    ],
)
def test_a_probe_or_a_trespass_is_caught(found: Found, source: str) -> None:
    assert list(found(ast.parse(source))) == [1]


@pytest.mark.parametrize(
    ("found", "source"),
    [
        (probed, "isinstance(given, Model)"),
        (probed, "isinstance(path, str | Path)"),
        (probed, "model.gives('state_space')"),
        (probed, "getattr(record, 'dt', None)"),
        (probed, "class FrfModel(Model):\n    def same(self, x):\n        return isinstance(x, FrfModel)"),
        (trespassed, "self._columns"),
        (trespassed, "super()._length2(x)"),
        (trespassed, "model.__dict__"),
        (trespassed, "class A:\n    def _take(self): ...\n    def of(self, other):\n        other._take()"),
    ],
)
def test_asking_and_what_is_ones_own_pass(found: Found, source: str) -> None:
    assert list(found(ast.parse(source))) == []
