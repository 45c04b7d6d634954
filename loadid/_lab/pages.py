"""Which pages there are: those of this package and of every other that names one."""

from __future__ import annotations

import logging
from importlib import import_module
from importlib.metadata import entry_points

from .contract import Page

GROUP = "loadid.lab"
_OWN: tuple[str, ...] = ("contact", "lcurve", "own", "cards")
log = logging.getLogger(__name__)


def pages() -> list[Page]:
    """All pages, our own first; one that cannot be loaded is left out, and logged."""
    found = {name: import_module(f".{name}", __package__).page for name in _OWN}
    for point in sorted(entry_points(group=GROUP), key=lambda one: one.name):
        if point.name in found:
            continue
        try:
            found[point.name] = point.load()
        except Exception as error:  # a broken page of another package must not take the others down
            log.warning("the page %r (%s) is left out: %s", point.name, point.value, error)
    return list(found.values())
