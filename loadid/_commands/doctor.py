"""``loadid doctor``: versions, threads, extras, and whose the packages are that Python finds under the three names."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shutil
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from structures._threads import threads

from .. import __version__
from . import Command, emit, table

DISTRIBUTION, PACKAGES = "loadid", ("structures", "loadid", "tactile")
SHOWN = ("vision", "cluster", "brokers", "io", "mcap")  # extras of users; the others are those of developers
CORE = ("numpy", "scipy", "casadi", "filterpy", "matplotlib", "h5py", "clarabel", "numba", "jinja2")
EXAMPLES = """\
examples:
  loadid doctor           # exit code 1 where another distribution holds one of the three package names
  loadid doctor --json    # the same for a report of a fault
"""
NAME = re.compile(r"[A-Za-z0-9._-]+")
EXTRA = re.compile(r"extra\s*==\s*['\"]([\w-]+)['\"]")


def owners(names: Mapping[str, list[str]] | None = None) -> dict[str, dict[str, Any]]:
    """Where Python finds each package, and which installed distributions say that it is theirs.

    Parameters
    ----------
    names : dict of package to distributions, optional
        As `importlib.metadata.packages_distributions` gives them, which reads the list of files of every one.
    """
    listed = metadata.packages_distributions() if names is None else names
    found: dict[str, dict[str, Any]] = {}
    home = Path(__file__).resolve().parents[2]
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        place = "" if spec is None or not spec.origin else str(Path(spec.origin).resolve().parent)
        others = sorted({d for d in listed.get(package, []) if d.lower() != DISTRIBUTION})
        ours = Path(place) == home / package if place else False
        found[package] = {"place": place, "ours": ours, "others": others}
    return found


def extras() -> dict[str, dict[str, str | None]]:
    """Version of every package of an extra, None where it is not installed; nothing where loadid itself is not."""
    try:
        required = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return {}
    found: dict[str, dict[str, str | None]] = {}
    for line in required:
        extra, name = EXTRA.search(line), NAME.match(line)
        if extra is not None and name is not None and extra[1] in SHOWN:
            found.setdefault(extra[1], {})[name[0]] = version(name[0])
    return found


def version(name: str) -> str | None:
    """Version of an installed distribution; None where it is none."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def examined() -> dict[str, Any]:
    """All that is known, as plain values."""
    import numpy as np

    np.linalg.svd(np.eye(2))  # the libraries of the linear algebra are there once they are used
    told = {k: v for k in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS") if (v := os.environ.get(k))}
    built: Any = np.show_config(mode="dicts") or {}
    blas = built.get("Build Dependencies", {}).get("blas", {})
    owned = owners()
    wrong = [name for name, one in owned.items() if one["others"] or not one["ours"]]
    return {
        "loadid": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "terminal": _terminal(),
        "blas": blas.get("name", "unknown"),
        "blas_version": blas.get("version", ""),
        "threads": threads(),
        "threads_told": told,
        "dependencies": {name: version(name) for name in CORE},
        "extras": extras(),
        "packages": owned,
        "wrong": wrong,
    }  # fmt: skip


def _terminal() -> dict[str, Any]:
    columns = shutil.get_terminal_size().columns
    encoding = sys.stdout.encoding or ""
    return {"output": sys.stdout.isatty(), "errors": sys.stderr.isatty(), "encoding": encoding, "columns": columns}


def show(data: dict[str, Any]) -> str:
    """Answer of `examined` as text, what is wrong first."""
    lines = [_first(data)]
    cores = f"{data['usable_cores']} of {data['cores']} cores"
    lines.append(f"  loadid {data['loadid']}, Python {data['python']}, {data['system']}, {cores}")
    told = ", ".join(f"{k}={v}" for k, v in data["threads_told"].items()) or "not set in the environment"
    count = ", ".join(map(str, data["threads"])) or "not known"
    lines.append(f"  linear algebra: {data['blas']} {data['blas_version']}, threads {count} ({told})")
    screen = data["terminal"]
    where = f"{screen['columns']} columns" if screen["output"] else "standard output is no terminal"
    lines.append(f"  terminal: {where}, {screen['encoding']}")
    lines.append("  " + ", ".join(f"{name} {v or 'MISSING'}" for name, v in data["dependencies"].items()))
    rows = [["extra", "installed", "missing", "to install"]]
    for extra, some in data["extras"].items():
        gone = [name for name, v in some.items() if v is None]
        there = ", ".join(f"{name} {v}" for name, v in some.items() if v is not None)
        rows.append([extra, there or "-", ", ".join(gone) or "-", f'pip install "loadid[{extra}]"' if gone else "-"])
    lines += [table(rows)] if len(rows) > 1 else ["  extras: not known, as loadid is not installed (pip install -e .)"]
    lines += [f"  package {name}: {one['place'] or 'not found'}" for name, one in data["packages"].items()]
    return "\n".join(lines)


def _first(data: dict[str, Any]) -> str:
    """The answer in a line."""
    missing = [name for name, v in data["dependencies"].items() if v is None]
    if data["wrong"]:
        one = data["packages"][name := data["wrong"][0]]
        whose = (
            f"belongs to {', '.join(one['others'])} too"
            if one["others"]
            else f"is found at {one['place'] or 'no place'}"
        )
        return f"the package name {name} {whose}: uninstall that, or install loadid in an environment of its own"
    if missing:
        return f"missing: {', '.join(missing)} (pip install {' '.join(missing)})"
    return "loadid is in order"


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter


def _run(args: Namespace) -> int:
    data = examined()
    emit(args, data, show(data))
    return 1 if data["wrong"] or None in data["dependencies"].values() else 0


command = Command("doctor", "versions, threads, extras, and whose the package names are", _configure, _run)
