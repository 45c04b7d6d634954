"""The script of the charts does what the Python that drew them does: same ticks, same heights, same extremes.

Run by node where it is installed, on the script as it stands in the page, without a browser.
"""

import json
import shutil
import subprocess

import numpy as np
import pytest

from loadid import _page
from loadid._page.chart import COLUMNS, Chart, Curve, extremes, height, numbers, shares, ticks, written

node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")


def asked(tmp_path, code):
    """What the functions of the script answer."""
    (tmp_path / "charts.js").write_text(_page.code_of(_page.CHARTS) + f"\nconsole.log(JSON.stringify({code}));")
    done = subprocess.run(["node", str(tmp_path / "charts.js")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


RANGES = [(0, 1), (-3.7, 12.2), (47.0, 56.6), (1e-7, 3e-7), (-2e6, 5e6), (0.999, 1.001), (28.4, 163.4)]
LOGS = [(1e-6, 1.0), (2.0, 9.0), (0.3, 40.0), (1e-12, 1e9), (101.0, 103.0)]
VALUES = [0.0, 1.0, -0.25, 1234.5678, 99999.0, 1e5, -2.5e-5, 0.001, 0.00099, 1e-300, 12345.6]


@node
def test_ticks_and_numbers_are_those_of_the_drawing(tmp_path):
    found = asked(
        tmp_path,
        f"[{json.dumps(RANGES)}.map(r => ticks(...r, false, 6)), {json.dumps(LOGS)}.map(r => ticks(...r, true, 6)),"
        f"{json.dumps(VALUES)}.map(written)]",
    )
    for ends, there in zip(RANGES, found[0], strict=True):
        np.testing.assert_allclose(there, ticks(*ends), rtol=1e-12)
    for ends, there in zip(LOGS, found[1], strict=True):
        np.testing.assert_allclose(there, ticks(*ends, log=True), rtol=1e-12)
    assert found[2] == [written(v) for v in VALUES]


def chart(samples=30_000, **changes):
    rng = np.random.default_rng(5)
    y = rng.standard_normal(samples).astype("<f4").astype(float)
    y[samples // 7] = 12.0
    y[samples // 3 : samples // 3 + 2000] = np.nan
    return Chart(
        title="t", x_name="time [s]", y_name="load [N]", x=0.5 + 1e-3 * np.arange(samples), said="",
        curves=[Curve("estimate", y, low=y - 1, high=y + 2)], **changes,
    )  # fmt: skip


@node
def test_what_is_drawn_after_a_zoom_is_what_is_there(tmp_path):
    given = chart(samples=18_000)
    view = (2.0, 9.25)
    found = asked(
        tmp_path,
        f"(() => {{ const c = opened({numbers(given)}), e = height(c, {[*view]});"
        f"return [e, path(c, c.curves[0], 'y', {[*view]}, e, 500), band(c, c.curves[0], {[*view]}, e, 500)]; }})()",
    )
    ends = height(given, view)
    np.testing.assert_allclose(found[0], ends, rtol=1e-6)
    y, x = given.curves[0].y, given.x
    inside = (x >= view[0]) & (x <= view[1]) & np.isfinite(y)
    units = np.array(found[1].replace("M", " ").replace("h0", " ").split(), float).reshape(-1, 2)
    shown = 1000 * (1 - shares(y[inside], ends))
    np.testing.assert_allclose([units[:, 1].min(), units[:, 1].max()], [shown.min(), shown.max()], atol=1)
    assert len(units) <= 4 * 502
    assert found[1].count("M") == 2  # the gap
    assert found[2].count("z") == 2


def test_the_extremes_of_every_column_are_kept():
    rng = np.random.default_rng(1)
    u, y = np.sort(rng.uniform(0, 1, 20_000)), rng.standard_normal(20_000)
    y[500:900] = np.nan
    at, drawn = extremes(u, y, 100)
    for k in range(100):
        mine, all_ = (np.floor(100 * a) == k for a in (at, u))
        if np.isfinite(y[all_]).any():
            assert np.nanmin(drawn[mine]) == np.nanmin(y[all_])
            assert np.nanmax(drawn[mine]) == np.nanmax(y[all_])
    few, same = extremes(u[:1000], y[:1000], COLUMNS)
    assert few is not None
    np.testing.assert_array_equal(same, y[:1000])


@node
def test_the_table_holds_what_is_in_view_and_runs_nowhere(tmp_path):
    """Numbers to seven digits; a name that a spreadsheet would take for a formula is text."""
    x, y = np.array([0.0, 1.0, 2.0, 3.0]), np.array([-1.5, np.nan, 1 / 3, 4.0])
    given = Chart(
        title="t", x_name="time [s]", y_name="", x=x, said="",
        curves=[Curve('=HYPERLINK("x")', y, low=y - 1, high=y + 1), Curve("a, b", np.array([9.0]), x=np.array([2.0]))],
    )  # fmt: skip
    text = asked(tmp_path, f"table(opened({numbers(given)}), [0.5, 3])")
    head, *rows = text.strip().split("\r\n")
    assert head.startswith('time [s],"\'=HYPERLINK(""x"")"')
    assert head.endswith('"a, b"')
    assert [row.split(",") for row in rows] == [
        ["1", "", "", "", ""], ["2", "0.3333333", "-0.6666667", "1.333333", "9"], ["3", "4", "3", "5", ""],
    ]  # fmt: skip


@node
@pytest.mark.parametrize("size", [1e-40, 1e200])
def test_numbers_of_any_size_travel(size, tmp_path):
    y = size * np.array([1.0, -2.0, 3.0])
    given = Chart(title="", x_name="", y_name="", x=np.arange(3.0), curves=[Curve("", y)], said="")
    assert asked(tmp_path, f"Array.from(opened({numbers(given)}).curves[0].y)") == y.tolist()


@node
def test_a_record_too_long_to_travel_keeps_its_extremes(tmp_path):
    given = chart(samples=200_000)
    found = asked(
        tmp_path,
        f"(() => {{ const c = opened({numbers(given)}), y = Array.from(c.curves[0].y).filter(Number.isFinite);"
        "return [c.every, y.length, Math.min(...y), Math.max(...y)]; })()",
    )
    y = given.curves[0].y
    assert found[0] == 40
    assert found[1] <= 20_000
    assert found[2:] == [np.nanmin(y), np.nanmax(y)]


@node
@pytest.mark.parametrize("name", [_page.CHARTS, _page.TABLES])
def test_the_scripts_are_javascript(name, tmp_path):
    (tmp_path / "page.js").write_text(_page.code_of(name))
    done = subprocess.run(["node", "--check", str(tmp_path / "page.js")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
