"""What is in a universal file that holds no record: its FRFs and spectra, in a few words."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def content(path: str | Path) -> dict[str, Any] | None:
    """Functions, degrees of freedom and axes of a universal file; None of any other file, and of one with records.

    Raises
    ------
    InputError
        If it is one and is damaged.
    """
    from structures.files.uff import SUFFIXES, read_uff
    from structures.files.uff_functions import FRF, TIME

    if Path(path).suffix.lower() not in SUFFIXES or not Path(path).is_file():
        return None
    file = read_uff(path)
    if not file.functions or any(f.head.function == TIME for f in file.functions):
        return None
    found: dict[str, Any] = {"title": file.title} if file.title else {}
    found["functions"] = file.holds()
    for name, axis in (("response", 1), ("reference", 2)):
        texts = {getattr(f, name) or "not named": f.head.axes[axis].unit for f in file.functions}
        listed = [f"{label} [{unit}]" if unit else label for label, unit in texts.items()]
        found[f"{name}s"] = ", ".join(listed[:50]) + (f" and {len(listed) - 50} more" if len(listed) > 50 else "")
    spans = {(len(f.abscissa), f.abscissa[0], f.abscissa[-1], f.axis.unit) for f in file.functions}
    found["axes"] = "; ".join(f"{n} values, {a:.6g} to {b:.6g} {unit}".strip() for n, a, b, unit in sorted(spans)[:8])
    found |= {"notes": "; ".join(file.notes)} if file.notes else {}
    if any(f.head.function == FRF for f in file.functions):
        found["to_read_it"] = f'structures.files.read_frfs("{path}") gives a model'
    return found
