"""Pictures of what the data can tell and of load fields: what they show is what the numbers say."""

import numpy as np
import pytest

from loadid import LoadEstimate
from loadid import _plots as plots
from structures.errors import InputError
from tests.loadid.diagnosed import line, surface
from tests.loadid.made import impact
from tests.loadid.test_plots import words
from tests.loadid.test_report import Page

KINDS = ["picard", "filter_factors", "resolution", "columns", "lcurve", "gcv"]


@pytest.fixture(scope="module")
def estimate():
    return line()[0]


def lines(ax):
    return {x.get_label(): x for x in ax.get_lines()}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("narrow", [False, True])
def test_every_picture_has_names_legend_plateau_and_marks(kind, narrow, estimate):
    figure = getattr(plots, kind)(estimate, narrow=narrow)
    figure.draw_without_rendering()
    for ax in figure.axes:
        named = ax.get_xlabel() or ax.get_ylabel()
        assert named, kind
    assert any(ax.get_legend() for ax in figure.axes) or figure.legends
    text = words(figure)
    assert "forward model not verified" in text
    if kind != "columns":
        assert f"i* = {estimate.diagnosis.plateau}" in text
    if kind in ("picard", "filter_factors", "lcurve", "gcv"):
        assert f"discrepancy: {estimate.choice.lam:.2g} (used)" in text
        for rule in estimate.choice.rules:
            assert rule.lam is None or f"{rule.rule}: {rule.lam:.2g}" in text
    assert figure.get_figwidth() <= 4.0 if narrow else figure.get_figwidth() > 5


@pytest.mark.parametrize("kind", [*KINDS, "field"])
def test_every_picture_is_reached_by_name(kind, estimate, tmp_path):
    estimate.plot(kind, path=tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 5000


def test_picard_shows_coefficients_singular_values_and_lambdas(estimate):
    d = estimate.diagnosis
    ax, twin = plots.picard(estimate).axes
    drawn = lines(ax)
    np.testing.assert_array_equal(drawn["data coefficient |u·y|"].get_ydata(), d.coefficients)
    assert drawn["plateau: noise"].get_ydata()[0] == d.floor
    assert drawn[f"i* = {d.plateau}"].get_xdata()[0] == d.plateau + 0.5
    np.testing.assert_allclose(twin.get_lines()[0].get_ydata(), d.generalised / d.generalised[0])
    marks = [x for x in twin.get_lines() if x.get_marker() not in ("None", "")]
    assert marks[0].get_ydata()[0] == estimate.choice.lam
    at = marks[0].get_xdata()[0]  # on the curve of the singular values
    gamma = d.generalised / d.generalised[0]
    assert gamma[int(np.ceil(at)) - 1] <= estimate.choice.lam <= gamma[int(np.floor(at)) - 1]
    assert len(marks) == len([r for r in estimate.choice.rules if r.lam is not None])


def test_filter_factors_cross_a_half_at_lambda(estimate):
    ax = plots.filter_factors(estimate).axes[0]
    drawn = lines(ax)
    np.testing.assert_array_equal(
        drawn["filter factor at the lambda used"].get_ydata(), estimate.diagnosis.filter_factors
    )
    half = np.interp(-0.5, -estimate.diagnosis.filter_factors, np.arange(1, 33))
    used = next(x for label, x in drawn.items() if "(used)" in label)
    assert used.get_xdata()[0] == pytest.approx(half, abs=0.25)


def test_resolution_shows_the_matrix_and_the_widths(estimate):
    d = estimate.diagnosis
    figure = plots.resolution(estimate)
    image = figure.axes[0].get_images()[0]
    np.testing.assert_array_equal(image.get_array(), d.matrix)
    spreads = figure.axes[1]
    assert spreads.get_xlabel() == "x [m]"
    np.testing.assert_array_equal(spreads.get_lines()[0].get_ydata(), d.point_spreads[:, 0])
    assert f"width {d.width:.3g} m" in words(figure)


def test_on_a_surface_point_spreads_are_over_the_distance():
    figure = plots.resolution(surface()[0])
    assert any(ax.get_xlabel() == "distance from the load [m]" for ax in figure.axes)


def test_columns_are_in_noise_levels(estimate):
    left = plots.columns(estimate).axes[0]
    size = np.abs(estimate.load).max()  # a unit load would vanish in the noise of most set-ups
    np.testing.assert_allclose(left.get_lines()[0].get_ydata(), size * estimate.diagnosis.signatures[:, 0])
    assert "noise std" in left.get_ylabel()
    assert f"{size:.3g}" in left.get_ylabel()


def test_estimates_without_a_diagnosis_are_refused():
    for kind in ("picard", "filter_factors", "resolution", "columns"):
        with pytest.raises(InputError, match="no diagnosis"):
            impact().plot(kind)


# -- fields -----------------------------------------------------------------------------------------------------------
def test_a_line_is_drawn_over_its_places_with_band_and_truth(estimate):
    truth = line()[1]
    ax = estimate.plot(truth=truth).axes[0]
    drawn = lines(ax)
    np.testing.assert_array_equal(drawn["estimate"].get_ydata(), estimate.load)
    np.testing.assert_array_equal(drawn["truth"].get_ydata(), truth)
    np.testing.assert_array_equal(drawn["estimate"].get_xdata(), estimate.geometry["coordinates"][:, 0])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "traction [N/m]")
    corners = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert corners.max() == pytest.approx(estimate.band()[1].max())


def colours(figure):
    """Values on the maps of a figure, by title."""
    return {ax.get_title(loc="left"): ax.collections[0].get_array() for ax in figure.axes if ax.get_title(loc="left")}


def test_nodal_forces_are_maps_in_newton_with_their_std():
    e, truth = surface()
    figure = plots.field(e, truth=truth)
    maps = colours(figure)
    assert set(maps) == {f"{c} {k}" for c in ("+X", "+Z") for k in ("estimate", "truth", "std")}
    np.testing.assert_allclose(maps["+Z estimate"], e.load[1::2])
    np.testing.assert_allclose(maps["+X std"], e.std[0::2])
    text = words(figure)
    assert "force [N]" in text
    assert "Pa" not in text
    assert "nodal forces: they scale with the element size" in text
    assert {"x [m]", "y [m]"} <= {ax.get_xlabel() or "y [m]" for ax in figure.axes}


def test_tractions_are_converted_with_their_std():
    e, truth = surface()
    maps = colours(plots.field(e, "traction", truth=truth))
    np.testing.assert_allclose(maps["+Z estimate"], e.traction()[1::2])
    area = e.geometry["measures"][0]
    np.testing.assert_allclose(maps["+Z std"], e.std[1::2] / area, rtol=1e-6)
    np.testing.assert_allclose(maps["+Z truth"], truth[1::2] / area)
    assert "traction [Pa]" in words(plots.field(e, "traction"))


def test_nodal_forces_are_never_labelled_as_a_pressure():
    text = words(plots.field(surface()[0], "pressure"))
    assert "LID-W106" in text
    assert "force [N]" in text
    assert "[Pa]" not in text


def test_patches_are_cells_of_pressure():
    e, _ = surface("patches", ("+Z",))
    figure = e.plot()
    assert "traction [Pa]" in words(figure)
    table = colours(figure)["+Z estimate"].reshape(6, 7)
    np.testing.assert_allclose(table, e.load.reshape(7, 6).T)
    assert "W106" not in words(plots.field(e, "pressure"))
    with pytest.raises(InputError, match="carries tractions"):
        plots.field(e, "force")


def test_frames_are_lines_over_the_frame_and_one_frame_is_a_field():
    e, truth = line(32, 20)
    figure = e.plot()
    assert figure.axes[-1].get_xlabel() in ("frame", "")
    assert any(ax.get_xlabel() == "frame" for ax in figure.axes)
    drawn = lines(plots.field(e, truth=truth, frame=3).axes[0])
    np.testing.assert_array_equal(drawn["estimate"].get_ydata(), e.load[3])
    assert "frame 4 of 20" in words(plots.field(e, frame=3))


def test_scattered_places_and_wrong_questions():
    e, _ = surface("patches", ("+Z",))
    rng = np.random.default_rng(0)
    moved = {
        **e.geometry,
        "coordinates": e.geometry["coordinates"] + [*rng.uniform(0, 1e-3, 2), 0] * rng.random((42, 3)),
    }
    from dataclasses import replace

    scattered = plots.field(replace(e, geometry=moved))
    np.testing.assert_allclose(colours(scattered)["+Z estimate"], e.load)
    with pytest.raises(InputError, match="no such quantity"):
        plots.field(e, "weight")
    with pytest.raises(InputError, match="no places"):
        plots.field(replace(e, geometry=None))
    with pytest.raises(InputError, match="known load does not fit"):
        plots.field(e, truth=np.ones(3))


# -- report, summary, file --------------------------------------------------------------------------------------------
def test_the_report_says_what_the_data_can_tell(estimate):
    from loadid._results.report import page

    read = Page(page(estimate))
    for word in (
        "What the data can tell",
        f"i* = {estimate.diagnosis.plateau} of 32",
        "nullity 0",
        "exponential",
        "m wide",
    ):
        assert word in read.text, word
    titles = [chart["title"] for chart in read.charts]
    assert f"i* = {estimate.diagnosis.plateau} recoverable modes of {estimate.diagnosis.seen}" in titles
    assert {"singular values", "point spreads: what is shown of one load", "height left of a single load"} <= set(
        titles
    )
    assert len(titles) == len([words for words in read.values("aria-label") if words])


def test_the_summary_holds_the_diagnosis(estimate):
    d, text = estimate.diagnosis, estimate.summary(details=True)
    assert f"i* = {d.plateau} of {d.seen}" in text
    assert f"condition number {d.kappa:.3g} of the visible part, rank 32 and nullity 0" in text
    assert f"100 x buys x {d.decay.buys(100, d.snr):.3g}" in text
    assert f"{d.width:.3g} m wide" in text


def test_it_is_in_the_file_and_comes_back(estimate, tmp_path):
    estimate.save(tmp_path / "e.h5")
    d, back = estimate.diagnosis, LoadEstimate.read(tmp_path / "e.h5").diagnosis
    assert (back.plateau, back.decay, back.width_unit) == (d.plateau, d.decay, "m")
    for name in ("generalised", "coefficients", "matrix", "point_spreads", "columns"):
        np.testing.assert_array_equal(getattr(back, name), getattr(d, name))
    short = estimate.to_dict(arrays=False)["diagnosis"]
    assert short["plateau"] == d.plateau
    assert not any(isinstance(v, list) for v in short.values())
