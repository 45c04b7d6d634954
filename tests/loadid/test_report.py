"""The report is one page that fetches nothing, hides nothing and runs nothing but its own script."""

import base64
import hashlib
import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from loadid import _page
from loadid._page.chart import COLUMNS
from loadid._results.report import fragment, page
from loadid._results.summary import plus_minus
from structures import Flag
from structures._flags import Evidence, table
from structures.errors import InputError
from tests.loadid.made import CERTIFICATE, half_sine, impact, static

VOID = {"meta", "br", "img", "source"}


def small(**changes):
    """One picture instead of three."""
    return impact(**{"choice": None, "response": None, "residual": None, **changes})


@pytest.fixture(scope="module")
def whole():
    return page(impact(allowed=["W407"]), truth=half_sine()[1])


(PEAK,) = impact().peaks
BAND = f"{plus_minus(PEAK.value, 1.959964 * PEAK.std)} N"


class Page(HTMLParser):
    """Collects tags, attributes and text, and checks the nesting."""

    def __init__(self, source):
        super().__init__()
        self.tags, self.attributes, self.texts, self.open = [], [], [], []
        self.feed(source)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *a) for a in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())

    def values(self, name):
        return [value for _, key, value in self.attributes if key == name]

    @property
    def charts(self):
        """What the script is given of every chart."""
        return [json.loads(text) for text in self.values("data-chart")]


def test_the_page_says_all_that_must_be_known(whole):
    read = Page(whole)
    for word in ("Result", "Flags", "How lambda was chosen", "What the data cannot tell", "Measured against predicted",
                 "Verification", "Provenance", "forward model not verified", "allowed: LID-W407",
                 "LID-W114 warning", "What to do: hang a known mass", "impulse 1.2", "robust_gcv", "sigma is not known",
                 "9 of 10 such problems", "nullity", "white noise", "numpy", "abab", "std 15 N"):  # fmt: skip
        assert word in read.text, word
    titles = ["11+Z", "1+Z", "2+Z", "3+Z", "L-curve", "residual over lambda", "GCV function"]
    assert [chart["title"] for chart in read.charts] == titles
    plots = [tag for tag, key, value in read.attributes if (key, value) == ("class", "plot")]
    assert plots == ["svg"] * len(titles)
    assert len([words for words in read.values("aria-label") if words]) == len(titles) + 1  # and one overview


def test_the_answer_comes_first_then_the_picture_then_cautions_and_the_rest_is_folded(whole):
    marks = ('<div class="answer">', f">{BAND}<", "95 % band", "<span>grade ", "data-chart", "<h2>Cautions</h2>",
             "<details", "<h2>How lambda was chosen</h2>", "<h2>Provenance</h2>")  # fmt: skip
    order = [whole.index(mark) for mark in marks]
    assert order == sorted(order)
    folded = re.findall(r"<summary><h2>(.*?)</h2></summary>", whole)
    assert {"Flags", "Verification", "Provenance", "How lambda was chosen"} <= set(folded)
    assert not {"Result", "Cautions"} & set(folded)


def test_of_many_cautions_the_three_that_matter_most_are_shown():
    flags = [Flag("W206", Evidence("clipped", k, 0), f"finding {k}", "look", effect=float(k)) for k in range(5)]
    text = page(small(flags=flags)).partition("<details")[0]
    assert [int(k) for k in re.findall(r"finding (\d)", text)] == [4, 3, 2]
    assert "2 more remarks below" in text


def test_the_certificate_replaces_the_warning():
    read = Page(page(small(certificate=CERTIFICATE)))
    assert "not verified" not in read.text
    assert "hanging mass 2 kg" in read.text
    assert "0.999" in read.text


def test_nothing_is_fetched(whole):
    read = Page(whole)
    assert all(source.startswith("data:image/") for source in [*read.values("src"), *read.values("srcset")])
    assert not set(read.tags) & {"link", "iframe", "object", "embed", "base", "form"}
    assert all(target.startswith("#") for target in read.values("href"))  # places on the page itself
    style = next(t for t in read.texts if "color-scheme" in t)
    assert "url(" not in style
    assert "@import" not in style
    assert "width=device-width" in whole


def test_the_policy_lets_only_its_own_script_and_style_run(whole):
    read = Page(whole)
    policy = next(v for v in read.values("content") if "default-src" in v)
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    for tag, rule in (("script", "script-src"), ("style", "style-src")):
        assert read.tags.count(tag) == 1
        inside = re.search(rf"<{tag}>(.*?)</{tag}>", whole, re.S).group(1)
        digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
        assert f"{rule} 'sha256-{digest}'" in policy
    assert not [key for _, key, _ in read.attributes if key.startswith("on") or key == "style"]  # the policy stops them
    script = _page.code_of(_page.CHARTS)
    assert not re.search(
        r"fetch\(|XMLHttpRequest|WebSocket|import\(|innerHTML|insertAdjacent|document\.write|eval\(", script
    )


EVIL = '"><script>alert(1)</script><img src=x onerror=alert(1)> $\\'


@pytest.mark.parametrize("make", [page, fragment])
def test_every_text_is_escaped(make):
    e = impact(rows=1, choice=None, samples=64,
        labels=[EVIL], units=[EVIL], sensors=[EVIL], sensor_units=[EVIL],
        flags=[Flag("W114", Evidence(EVIL, EVIL, EVIL), EVIL, EVIL)],
        provenance={EVIL: {EVIL: [EVIL]}, "family": EVIL, "prior": EVIL, "created": EVIL},
        facts={EVIL: EVIL},
        certificate=type(CERTIFICATE)((1.0,), (1.0,), (0.1,), None, (EVIL,), EVIL, EVIL),
    )  # fmt: skip
    text = make(e)
    read = Page(text)
    own = f"<script>{_page.code_of(_page.CHARTS)}</script>"
    assert "script" not in Page(text.replace(own, "")).tags
    assert text.count(own) == (make is page)
    assert not read.values("onerror")
    assert not {"img", "source"} & set(read.tags)
    assert "alert(1)" in read.text  # shown as text
    assert all(chart["title"] == EVIL for chart in read.charts)
    assert len(read.charts) == 2 * (make is page)


@pytest.mark.parametrize("make", [page, fragment])
def test_nothing_that_a_terminal_obeys_gets_through(make):
    """Escape sequences, bells, backspaces and marks that turn the direction of text, in every name."""
    bad = "a\x1b[31mb\x07c\x08d\u202ee\x9b0m\x00f\x7f"
    e = small(
        labels=[bad], units=[bad], sensors=[bad] * 3, flags=[Flag("W114", Evidence(bad, bad, bad), bad, bad)],
        provenance={bad: {bad: [bad]}, "family": bad, "prior": bad, "notes": [bad]}, facts={bad: bad},
        certificate=type(CERTIFICATE)((1.0,), (1.0,), (0.1,), None, (bad,), bad, bad),
    )  # fmt: skip
    text = make(e)
    assert {c for c in text if not c.isprintable()} <= {"\n"}
    assert "[31mb" in text


def test_a_long_record_stays_small_and_its_extremes_are_drawn():
    """A spike of one sample among half a million is in the picture, at its height."""
    rng = np.random.default_rng(0)
    e = small(samples=500_000, posterior=None)
    load = 0.01 * rng.standard_normal((500_000, 1))
    load[123_456] = -700.0
    load[400_001] = 900.0
    text = page(small(samples=500_000, posterior=None, load=load, std=np.zeros_like(load)))
    assert len(text) < 1.5e6
    assert len(page(e)) < 1.5e6
    path = re.search(r'<path class="curve estimate" d="([^"]*)"', text.partition('class="plot"')[2]).group(1)
    heights = np.array(re.findall(r"-?\d+", path.replace("h0", "")), float)[1::2]
    assert len(heights) <= 4 * COLUMNS
    scale = 1000 / (1600 * 1.1)  # a margin of 5 % on each side
    np.testing.assert_allclose([heights.min(), heights.max()], [80 * scale, 1680 * scale], atol=1)
    (chart,) = Page(text).charts
    (curve,) = chart["curves"]
    y = np.frombuffer(base64.b64decode(curve["y"]), "<f4")
    assert (y.min(), y.max()) == (-700, 900)
    assert chart["every"] == 100


def test_what_a_picture_must_not_travel_without_is_there_to_be_saved(whole):
    (note,) = Page(whole).values("data-note")
    assert (
        note == f"grade {impact().grade.letter}  |  forward model not verified  |  allowed: LID-W407  |  cautions: W114"
    )
    assert "dataset.note" in _page.code_of(_page.CHARTS)


def test_a_hit_is_shown_enlarged_above_its_whole_record(whole):
    chart = Page(whole).charts[0]
    first, last = chart["window"]
    assert first < 11 < last  # ms
    assert last - first < 0.5 * (chart["whole"][1] - chart["whole"][0])
    assert whole.count('class="strip"') == 1
    assert 'class="strip"' not in page(small(load=np.ones((400, 1))))


def test_a_gap_is_no_line():
    """Lines that are not trusted leave their estimate out."""
    from loadid._page.chart import Chart, Curve, picture

    y = np.where(np.arange(100) // 10 == 4, np.nan, 1.0)
    (line,) = picture(Chart(title="", x_name="", y_name="", x=np.arange(100.0), curves=[Curve("", y)], said=""))[
        "paths"
    ]
    assert line[1].count("M") == 2


def test_no_matplotlib_is_loaded_for_lines():
    code = """
import sys
from tests.loadid.made import impact, static
impact()._repr_html_(), static()._repr_html_()
assert not {"matplotlib", "scipy"} & set(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_static_loads_and_missing_parts_make_a_page():
    read = Page(page(static()))
    assert "No lambda was chosen" in read.text
    assert "No guard raised a flag" in read.text
    Page(page(static(20, response=None, residual=None)))


def test_it_is_written_whole_and_is_the_same_each_time(tmp_path):
    e = small()
    e.report(tmp_path / "a.html")
    e.report(tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_a_folder_that_is_not_there_is_said_before_anything_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr("loadid._results.report.page", lambda *a, **k: pytest.fail("drawn in vain"))
    with pytest.raises(InputError, match=r"the folder does not exist.*none"):
        small().report(tmp_path / "none" / "a.html")


def test_notebooks_get_a_fragment():
    text = impact()._repr_html_()
    assert "<html" not in text
    read = Page(text)
    assert "forward model not verified" in read.text
    assert text.count('class="plot"') == 1
    assert not read.charts  # numbers for a script that is not there
    assert "script" not in read.tags
    assert BAND in read.text


def test_the_style_touches_nothing_but_its_own():
    """In a notebook it stands beside the styles of others: every rule begins with the class of the page."""
    style = re.sub(r"/\*.*?\*/", "", _page.text("page.css"), flags=re.S)
    style = re.sub(r"@media[^{]*", "", style)
    selectors = [s.strip() for rule in re.findall(r"([^{}]+)\{", style) for s in rule.split(",") if s.strip()]
    assert len(selectors) > 100
    assert all(s.startswith(".loadid") for s in selectors), [s for s in selectors if not s.startswith(".loadid")]


def test_numbers_that_are_not_finite_do_not_break_the_page():
    assert re.search(r"condition number.*inf", page(small(facts={"kappa": np.inf})), re.S)


def test_provenance_keeps_paths_and_says_what_defaults_are():
    provenance = {
        "inputs": {"my_long_folder/my_log.csv": "cd" * 32},
        "settings": {"choice": None, "hold": None, "sensors": None, "noise_source": None},
        "notes": ["step 0.001 s from the time column t_s"],
    }
    text = Page(page(small(provenance=provenance))).text
    for word in ("my_long_folder/my_log.csv", "settings: choice automatic", "settings: hold the model's own",
                 "settings: sensors all", "step 0.001 s from the time column t_s"):  # fmt: skip
        assert word in text, word


def test_charts_have_the_width_of_their_page(whole):
    """Places are shares of the width, so that letters keep their size on a phone and on paper."""
    texts = re.findall(r"<text x=\"([^\"]*)\" (?:dx=\"-?\d+\" )?y=\"([^\"]*)\"", whole)
    assert len(texts) > 50
    assert all(place in ("0", "100%") or place.endswith("%") for pair in texts for place in pair)
    for tag in re.findall(r"<svg class=\"(?:plot|strip)\"[^>]*>", whole):
        assert "width=" not in tag
        assert "viewBox" not in tag


def test_a_sentence_says_what_the_data_cannot_tell():
    facts = {"nullity": 5, "n": 400, "m": 300}
    assert "5 of 400 components of the load leave no trace" in Page(page(small(facts=facts))).text


def test_the_measured_line_is_seen_under_the_predicted_one():
    figure = impact().plot("response")
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert lines["measured"].get_linewidth() > 3 * lines["predicted"].get_linewidth()


def test_every_code_leads_to_what_it_means():
    """To the row of the table, on the same page, and to the command that prints it; a fragment has no links."""
    flags = tuple(Flag(code, Evidence("a", 1.0), "found") for code in ("W412", "W403", "W403", "N303"))
    text = page(small(flags=flags))
    for code in ("W412", "W403", "N303"):
        guard = table()[code]
        assert text.count(f'<dt id="LID-{code}">{code} ') == 1
        assert html.escape(guard.condition, quote=True).replace("&quot;", "&#34;").replace("&#x27;", "&#39;") in text
        assert f"loadid info {code}" in text
    assert set(re.findall(r'href="#(LID-\w+)"', text)) <= set(re.findall(r'id="(LID-\w+)"', text))
    assert 'href="#LID-W403"' in text
    assert 'href="#LID' not in fragment(small(flags=flags))
