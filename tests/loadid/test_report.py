"""The report is one page that fetches nothing, hides nothing and runs nothing."""

import base64
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest

from loadid._results.report import fragment, page
from structures import Flag
from structures._flags import Evidence
from structures.errors import InputError
from tests.loadid.made import CERTIFICATE, half_sine, impact, static

VOID = {"meta", "br", "img", "source"}


def small(**changes):
    """One picture instead of three."""
    return impact(**{"choice": None, "response": None, "residual": None, **changes})


@pytest.fixture(scope="module")
def whole():
    return page(impact(allowed=["W407"]), truth=half_sine()[1])


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


def test_the_page_says_all_that_must_be_known(whole):
    read = Page(whole)
    for word in ("Result", "Flags", "How lambda was chosen", "What the data cannot tell", "Measured against predicted",
                 "Verification", "Provenance", "forward model not verified", "allowed: LID-W407",
                 "LID-W114 warning", "What to do: hang a known mass", "impulse 1.2", "robust_gcv", "sigma is not known",
                 "9 of 10 such problems", "nullity", "white noise", "numpy", "abab", "± 15 N"):  # fmt: skip
        assert word in read.text, word
    assert read.tags.count("img") == 3
    assert all(read.values("alt"))


def test_the_certificate_replaces_the_warning():
    read = Page(page(small(certificate=CERTIFICATE)))
    assert "not verified" not in read.text
    assert "hanging mass 2 kg" in read.text
    assert "0.999" in read.text


def test_nothing_is_fetched(whole):
    read = Page(whole)
    assert all(source.startswith("data:image/") for source in [*read.values("src"), *read.values("srcset")])
    assert not set(read.tags) & {"script", "link", "iframe", "object", "embed", "base", "form"}
    assert not read.values("href")
    style = next(t for t in read.texts if "color-scheme" in t)
    assert "url(" not in style
    assert "@import" not in style
    assert "width=device-width" in whole
    for source in read.values("src"):
        for element in ET.fromstring(base64.b64decode(source.split(",")[1])).iter():
            links = [v for k, v in element.attrib.items() if k.endswith("href")]
            assert all(link.startswith("#") for link in links)


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
    read = Page(make(e))
    assert "script" not in read.tags
    assert not read.values("onerror")
    assert "alert(1)" in read.text  # shown as text


def test_dense_records_are_bitmaps_and_small_ones_vectors(whole):
    kinds = {s[5:].split(";")[0] for s in Page(whole).values("src")}
    assert kinds == {"image/svg+xml"}
    source = page(small(samples=6000, posterior=None))
    assert "image/png" in source
    assert len(source) < 2e6


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
    assert read.tags.count("img") == 1


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


def test_a_phone_gets_the_panels_below_each_other(whole):
    read = Page(whole)
    assert len(read.values("srcset")) == 3
    assert set(read.values("media")) == {"(max-width: 40rem)"}
    wide, narrow = (ET.fromstring(base64.b64decode(read.values(k)[0].split(",")[1])) for k in ("src", "srcset"))
    for picture, width in ((wide, 720), (narrow, 288)):
        assert float(picture.get("width").removesuffix("pt")) == width


def test_a_sentence_says_what_the_data_cannot_tell():
    facts = {"nullity": 5, "n": 400, "m": 300}
    assert "5 of 400 components of the load leave no trace" in Page(page(small(facts=facts))).text


def test_the_measured_line_is_seen_under_the_predicted_one():
    figure = impact().plot("response")
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert lines["measured"].get_linewidth() > 3 * lines["predicted"].get_linewidth()
