"""The house drawn: folders of the three packages as boxes, who loads whom as lines, read from the import graph."""

from __future__ import annotations

from collections import defaultdict

from tests.house import graph

WIDE, TALL, GAP, STEP, BOX = 660, 26, 14, 62, 7.2  # px: the drawing, a box, between boxes, between rows, a letter


def folders() -> dict[str, set[str]]:
    """Folder -> folders of which its modules load one; ``"loadid/_inverse"``."""
    found: dict[str, set[str]] = defaultdict(set)
    for module, loaded in graph().items():
        here = _folder(module)
        found[here] |= {there for name in loaded if (there := _folder(name)) != here}
    return {folder: found[folder] for folder in sorted(found)}


def _folder(module: str) -> str:
    parts = module.split(".")[:-1]
    return "/".join(parts[:2]) if len(parts) > 1 else parts[0]


def rows(edges: dict[str, set[str]]) -> list[list[str]]:
    """Folders by package, and there those that load others above what they load, as far as circles allow."""
    found: list[list[str]] = []
    for package in ("tactile", "loadid", "structures"):
        left = [folder for folder in edges if folder.split("/")[0] == package]
        while left:
            # what no other of those that are left loads; where they load each other in a circle, the least loaded
            loaded = {folder: sum(folder in edges[other] for other in left if other != folder) for folder in left}
            least = min(loaded.values())
            row = [folder for folder in left if loaded[folder] == least][:7]
            found.append(row)
            left = [folder for folder in left if folder not in row]
    return found


def beyond(edges: dict[str, set[str]], folder: str) -> set[str]:
    """What a folder loads and some other that it loads does, too: its lines would only hide the others."""
    loaded = edges[folder]
    return {other for other in loaded if any(other in edges[one] and folder not in edges[one]
                                             for one in loaded - {other})}  # fmt: skip


def drawn() -> str:
    """The drawing as SVG; colours are those of the page."""
    edges = folders()
    lines = rows(edges)
    place: dict[str, tuple[float, float]] = {}
    for k, row in enumerate(lines):
        wide = [len(name) * BOX + 16 for name in row]
        x = (WIDE - sum(wide) - GAP * (len(row) - 1)) / 2
        for name, w in zip(row, wide, strict=True):
            place[name] = (x + w / 2, 30 + STEP * k)
            x += w + GAP
    tall = 30 + STEP * len(lines)
    box = f'viewBox="0 0 {WIDE} {tall}" role="img" font-family="monospace" font-size="12"'
    title = "Folders of the three packages, those that load others above what they load"
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" {box}><title>{title}</title>']
    for name, loaded in edges.items():
        for other in sorted(loaded - beyond(edges, name)):
            (x, y), (u, v) = place[name], place[other]
            start, end = (y + TALL / 2, v - TALL / 2) if v > y else (y - TALL / 2, v + TALL / 2)
            middle = (start + end) / 2
            parts.append(f'<path d="M{x:.0f} {start:.0f}C{x:.0f} {middle:.0f} {u:.0f} {middle:.0f} {u:.0f} {end:.0f}" '
                         f'class="{name.split("/")[0]}"/>')  # fmt: skip
    for name, (x, y) in place.items():
        w = len(name) * BOX + 16
        parts.append(f'<rect x="{x - w / 2:.0f}" y="{y - TALL / 2:.0f}" width="{w:.0f}" height="{TALL}" rx="5" '
                     f'class="{name.split("/")[0]}"/><text x="{x:.0f}" y="{y + 4:.0f}" text-anchor="middle">{name}'
                     "</text>")  # fmt: skip
    style = ("path{fill:none;stroke-width:.8;opacity:.4}rect{stroke-width:1.4;fill:#fff}text{fill:#1b1f24}"
             ".structures{stroke:#0a6e31}.loadid{stroke:#0b57a4}.tactile{stroke:#a3370a}")  # fmt: skip
    parts.insert(1, f"<style>{style}</style>")
    return "\n".join([*parts, "</svg>"])
