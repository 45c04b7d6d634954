"""One self-contained HTML page of a load estimate: nothing is fetched, every text is escaped."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from structures.errors import InputError, plain
from structures.files._storage import as_path, replace

from .functionals import in_words
from .summary import (
    against,
    allowed,
    along,
    cannot_tell,
    comparison,
    diagnosis,
    facts,
    headline,
    impulses,
    noise,
    notes,
    number,
    plus_minus,
    refusals,
    rules,
    sort,
    state,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .estimate import LoadEstimate


_DENSE = 20_000  # plotted points beyond which a bitmap is smaller than a vector picture
_SHOWN = 12
# what a setting that was not given stands for
_DEFAULTS = {
    "choice": "automatic",
    "hold": "the model's own",
    "sensors": "all",
    "penalty": "none (plain least squares)",
    "noise": "estimated",
}


def write_report(estimate: LoadEstimate, path: str | os.PathLike[str], *, truth: ArrayLike | None = None) -> None:
    """Write the page, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_page(path, lambda: page(estimate, truth=truth))


def write_page(path: str | os.PathLike[str], made: Callable[[], str]) -> None:
    """Write a page, whole or not at all."""
    target = as_path(path)
    if not target.resolve().parent.is_dir():  # said before the pictures are drawn
        raise InputError(
            "the folder does not exist", where=str(target), found=str(target.resolve().parent),
            hint="make the folder first, or write elsewhere",
        )  # fmt: skip
    replace(target, made().encode())


def page(estimate: LoadEstimate, *, truth: ArrayLike | None = None, png: bytes | None = None) -> str:
    """The page as text; `png` is the picture of the load, where it has been drawn."""
    title = f"Load estimate: {', '.join(estimate.labels[:4])}" + (" …" if len(estimate.labels) > 4 else "")
    sections = [
        ("Result", _result(estimate) + _known(estimate, truth) + _picture(estimate, truth, png) + _notes(estimate)),
        ("Flags", flag_list(estimate)),
        ("What every line can tell", _lines(estimate)),
        ("How lambda was chosen", _choice(estimate)),
        ("What the data can tell", _diagnosis(estimate)),
        ("What the data cannot tell", _limits(estimate)),
        ("Measured against predicted", _response(estimate)),
        ("Verification", verification(estimate)),
        ("Provenance", provenance_table(estimate)),
    ]
    return document(title, estimate, sections)


def document(title: str, result: LoadEstimate, sections: Sequence[tuple[str, str]]) -> str:
    """A page of titled sections, below the family, the time and the notices of a result; empty ones are left out."""
    body = "\n".join(f"<section>\n<h2>{escape(name)}</h2>\n{text}\n</section>" for name, text in sections if text)
    known = (result.provenance.get("family"), result.provenance.get("created"))
    line = " · ".join(escape(str(x)) for x in known if x)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{escape(title)}</title>
<style>
{files("loadid").joinpath("report.css").read_text(encoding="utf-8")}</style>
</head>
<body>
<header>
<h1>{escape(title)}</h1>
<p class="quiet">{line}</p>
{notices(result)}
</header>
<main>
{body}
</main>
</body>
</html>
"""


def fragment(estimate: LoadEstimate) -> str:
    """Short form for notebooks: result, picture and flags."""
    return (
        f"<div>{notices(estimate)}{_result(estimate)}{_picture(estimate, None, phone=False)}{flag_list(estimate)}</div>"
    )


# -- sections ---------------------------------------------------------------------------------------------------------
def notices(e: LoadEstimate) -> str:
    """What must be known before the result is believed: overridden refusals, verification, band."""
    text = "".join(f'<p class="notice" role="alert">{escape(line)}</p>' for line in refusals(e))
    text += f'<p class="notice" role="note">{escape(str(e.grade))}</p>'
    if e.certificate is not None:
        kind = "notice" if e.certificate.wrong else "notice good"
        text += f'<p class="{kind}" role="note">{escape(e.verified)}</p>'
    text += f'<p class="quiet">{escape(state(e))}</p>'
    if e.allowed:
        text += f'<p class="notice" role="note">{escape(allowed(e))}</p>'
    return text


def _result(e: LoadEstimate) -> str:
    order = sorted(zip(e.peaks, impulses(e), strict=True), key=lambda pair: -abs(pair[0].value))
    cards = []
    for peak, impulse in order[:_SHOWN]:
        kind = "" if e.axis is None else "peak "
        at = "" if peak.at is None or e.axis is None else f" at {along(e.axis, peak.at)}"
        lines = [escape(peak.label), f"<b>{escape(f'{plus_minus(peak.value, peak.std)} {peak.unit}')}</b>"]
        lines.append(escape(" · ".join(x for x in (f"{kind}{at}".strip(), impulse) if x)))
        cards.append(f"<li>{lines[0]}{lines[1]}{lines[2]}</li>")
    more = len(order) - len(cards)
    note = "± one standard deviation" + (f"; {more} smaller loads not listed" if more else "")
    return f'<ul class="results">{"".join(cards)}</ul><p class="quiet">{note}</p>'


def _known(e: LoadEstimate, truth: ArrayLike | None) -> str:
    """How far the estimate lies from a known load, where there is one that is not zero."""
    if truth is None or e.axis is None:
        return ""
    import numpy as np

    known = np.asarray(plain(truth), complex if e.load.dtype.kind == "c" else float)
    known = known.reshape(e.load.shape) if known.size == e.load.size else known
    if known.shape != e.load.shape:
        return ""  # the picture refuses it in words
    lines = [
        (f"{label}, " if len(e.labels) > 1 else "") + comparison(against(e, known[:, j], j))
        for j, label in enumerate(e.labels[:_SHOWN])
        if np.any(known[:, j])
    ]
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _lines(e: LoadEstimate) -> str:
    """Bands that are not trusted, of an estimate over frequency lines."""
    if e.spectrum is None:
        return ""
    from .._plots import lines_figure

    s = e.spectrum
    trusted = s.trust()
    rows = [
        (label, f"{trusted[:, j].mean():.1%}", in_words(s.bands(j), 8) or "none")
        for j, label in enumerate(e.labels[:_SHOWN])
    ]
    head = ("load", f"lines predicted to {s.level:.0%} or better", "bands that are not trusted")
    words = "predicted relative error, gain and condition of every line"
    draw = partial(lines_figure, e)
    return html_table(rows, head) + html_image(lambda narrow=False: draw(), words, 6 * trusted.size, phone=False)


def _notes(e: LoadEstimate) -> str:
    lines = "".join(f"<li>{escape(note)}</li>" for note in notes(e))
    return f'<p class="quiet">Decided while reading the record:</p><ul class="quiet">{lines}</ul>' if lines else ""


def flag_list(e: LoadEstimate) -> str:
    """The flags, the gravest first."""
    if not e.flags:
        return "<p>No guard raised a flag.</p>"
    rows = "".join(
        f'<li class="{flag.level}"><b>{escape(flag.code)} {escape(flag.level)}</b>: {escape(flag.message)}'
        f'<br><span class="quiet">{escape(str(flag.evidence))}</span><br>What to do: {escape(flag.advice)}</li>'
        for flag in sort(e.flags)
    )
    return f'<ul class="flags">{rows}</ul>'


def _choice(e: LoadEstimate) -> str:
    if e.choice is None:
        return "<p>No lambda was chosen.</p>"
    rows = [*rules(e.choice)]
    text = f"<p>{escape(headline(e.choice))}</p><p>noise: {escape(noise(e.choice))}</p>"
    text += html_table(rows, ("rule", "relative lambda", "remark")) if rows else ""
    if e.choice.sweep is None:
        return text
    from .._plots import path_figure

    words = f"L-curve and residual over lambda; verdict {e.choice.verdict}"
    return text + html_image(partial(path_figure, e), words, e.choice.sweep.lam.size)


def _diagnosis(e: LoadEstimate) -> str:
    """Recoverable modes, decay, conditioning and point spreads, in words and in two pictures."""
    if e.diagnosis is None:
        return ""
    from .._plots import modes
    from .._plots import resolution as spreads

    d = e.diagnosis
    said = "".join(f"<li>{escape(line)}</li>" for line in diagnosis(e))
    first = html_image(
        partial(modes, e), f"Picard plot and filter factors, i* = {d.plateau} of {d.seen}", 4 * len(d.coefficients)
    )
    size = 0 if d.matrix is None else d.matrix.size
    second = html_image(partial(spreads, e), f"resolution and point spreads of {d.n} loads", size + 8 * d.n)
    return f"<ul>{said}</ul>{first}{second}"


def _limits(e: LoadEstimate) -> str:
    if not e.facts:
        return ""
    rows = facts(e)
    prior = e.provenance.get("prior")
    said = f"<p>{escape(cannot_tell(e))}</p>" if cannot_tell(e) else ""
    said += f"<p>What the data do not determine is filled by the prior: {escape(str(prior))}.</p>" if prior else ""
    return said + html_table(rows)


def _response(e: LoadEstimate) -> str:
    if e.response is None or e.residual is None:
        return ""
    from .._plots import response_figure

    names = ", ".join(e.sensors[:8])
    return html_image(partial(response_figure, e), f"measured and predicted response of {names}", 3 * e.response.size)


def verification(e: LoadEstimate) -> str:
    """The check of the forward model against a known load."""
    c = e.certificate
    if c is None:
        advice = "Check the model against a known load (model.verify) and the certificate travels with every estimate."
        return f"<p>{escape(e.verified)}.</p><p>{escape(advice)}</p>"
    ratios = c.noise_ratio or ("not known",) * len(c.sensors)
    rows = [
        (s, number(g), number(r), f"{x:.2%}", number(q))
        for s, g, r, x, q in zip(c.sensors, c.gain, c.shape, c.error, ratios, strict=True)
    ]
    head = ("sensor", "gain (1 is right)", "shape (1 is right)", "residual", "residual / noise")
    return f"<p>Checked against {escape(c.source)} on {escape(c.date)}.</p>" + html_table(rows, head)


def provenance_table(e: LoadEstimate) -> str:
    """Inputs, settings and versions, in rows."""
    return html_table(_flat(e.provenance)) if e.provenance else "<p>Not recorded.</p>"


# -- pieces -----------------------------------------------------------------------------------------------------------
def _flat(tree: Mapping[str, Any], prefix: str = "", parent: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in tree.items():
        if key == "notes":
            continue  # they stand with the result
        name = prefix + str(key).replace("_", " ")
        if parent == "inputs":  # paths stay as they are, in the column that wraps
            rows.append(("input", f"{key}, sha256 {value}"))
        elif isinstance(value, Mapping):
            rows += _flat(value, f"{name}: ", str(key))
        else:
            default = _DEFAULTS.get(str(key)) if value is None and parent == "settings" else None
            rows.append((name, default or number(value, 6)))
    return rows


def html_table(rows: Iterable[tuple[str, ...]], head: tuple[str, ...] = ()) -> str:
    """Rows of text as a table whose first column names the rest."""
    top = "<thead><tr>" + "".join(f'<th scope="col">{escape(h)}</th>' for h in head) + "</tr></thead>" if head else ""
    lines = (
        f'<tr><th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(str(x))}</td>" for x in row[1:]) + "</tr>"
        for row in rows
    )
    kind = ' class="columns"' if head else ""
    return f'<div class="scroll" tabindex="0"><table{kind}>{top}<tbody>{"".join(lines)}</tbody></table></div>'


def _picture(e: LoadEstimate, truth: ArrayLike | None, png: bytes | None = None, *, phone: bool = True) -> str:
    from .._plots import load_figure

    peaks = "; ".join(f"{p.label} peaks at {p.value:.4g} {p.unit}" for p in e.peaks[:3])
    draw = partial(load_figure, e, truth=truth)
    return html_image(draw, f"load with its 95 % band: {peaks}", 6 * e.load.size, png, phone=phone)


def html_image(
    draw: Callable[..., Figure], words: str, points: int, png: bytes | None = None, *, phone: bool = True
) -> str:
    """A figure as an image inside the page: its names and styles cannot meet those of the page or of another figure.

    A second one, with its panels below each other, is shown where the screen is narrow. Where a bitmap is wanted, `png`
    is taken if it is there.
    """
    suffix = "png" if points > _DENSE else "svg"
    content = png if png and suffix == "png" else _drawn(draw(), suffix)
    image = f'<img src="{_data(content, suffix)}" alt="{escape(words)}">'
    if not phone:
        return f'<figure tabindex="0">{image}</figure>'
    narrow = f'<source media="(max-width: 40rem)" srcset="{_data(_drawn(draw(narrow=True), suffix), suffix)}">'
    return f'<figure tabindex="0"><picture>{narrow}{image}</picture></figure>'


def _data(content: bytes, suffix: str) -> str:
    kind = {"png": "image/png", "svg": "image/svg+xml"}[suffix]
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _drawn(figure: Figure, suffix: str) -> bytes:
    from matplotlib import rc_context

    from .._plots.style import drawn

    keep: dict[str, Any] = {"metadata": {"Date": None}} if suffix == "svg" else {}
    with rc_context({"svg.hashsalt": "loadid", "svg.fonttype": "path"}):
        return drawn(figure, suffix, **keep)
