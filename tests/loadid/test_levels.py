"""Validation at its levels: resultants, distributions, held-out sensors, and what each of them proves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid import InputError, LoadEstimate, Record
from loadid._guards.measurement import resultant_only
from loadid._results.estimate import Axis
from loadid.validate import Known, PressureMat, ReferenceWrench, Validation, held_out, validate
from structures import Channel, MatrixModel
from structures.files import _storage as storage
from tests.loadid.made import impact

P = 12
X = (np.arange(P) + 0.5) / P
TRUTH = np.exp(-(((X - 0.45) / 0.12) ** 2))
C = np.vstack([np.ones(P), X]) / P


def line(load=TRUTH, kind="patches", components=("+Z",), **changes):
    """A pressure on twelve patches of a line of 1 m, with the geometry of a basis."""
    load = np.asarray(load, float)
    n = load.shape[-1]
    geometry = {
        "coordinates": X[:, None], "cells": None, "components": list(components), "kind": kind,
        "measures": np.full(P, 1 / P), "resultant": C if n == P else np.kron(C, np.ones(len(components))),
        "resultant_labels": ["F", "M"], "traction": None,
    }  # fmt: skip
    fields = {
        "load": load, "std": np.full(load.shape, 0.05), "labels": [f"p{i}" for i in range(n)], "units": ["N/m"] * n,
        "posterior": Flat(0.05**2 * np.eye(n)) if load.ndim == 1 else None, "geometry": geometry,
        "axis": None if load.ndim == 1 else Axis("frame", "", np.arange(float(len(load)))),
    }  # fmt: skip
    return LoadEstimate(**{**fields, **changes})


class Flat:
    """Posterior over loads alone, the same in every frame."""

    def __init__(self, covariance):
        self.covariance = covariance
        self.std = np.sqrt(np.diag(covariance))

    def variance(self, w):
        return np.einsum("...i,ij,...j->...", w, self.covariance, w)


# -- distributions -----------------------------------------------------------------------------------------------------
class TestDistribution:
    @given(st.lists(st.floats(-5, 5), min_size=P, max_size=P), st.floats(0.2, 3))
    @settings(max_examples=40, deadline=None)
    def test_numbers_against_their_definitions(self, noise, gain):
        found = gain * TRUTH + 0.05 * np.array(noise)
        (check,) = validate(line(found), TRUTH).checks
        best = np.linalg.lstsq(TRUTH[:, None], found, rcond=None)[0].item()
        assert check.error == pytest.approx(np.linalg.norm(found - TRUTH) / np.linalg.norm(TRUTH))
        assert check.gain == pytest.approx(best)
        left = np.linalg.norm(found - best * TRUTH) / np.linalg.norm(found)
        assert check.shape == pytest.approx(np.sign(best) * np.sqrt(max(1 - left**2, 0)), abs=1e-7)
        assert check.peak == found[np.argmax(np.abs(found))]
        assert check.band == pytest.approx(np.mean(np.abs(found - TRUTH) <= 1.959964 * 0.05))

    def test_gain_and_shape_are_told_apart(self):
        weak, moved = validate(line(0.8 * TRUTH), TRUTH), validate(line(np.roll(TRUTH, 2)), TRUTH)
        assert "shape right, gain 0.8: recheck E" in str(weak)
        assert weak.checks[0].shape == pytest.approx(1)
        assert weak.checks[0].peak_error == pytest.approx(-0.2)
        assert "shape wrong" in str(moved)
        assert moved.checks[0].peak_distance == pytest.approx(2 / P)
        assert (moved.checks[0].peak_at, moved.checks[0].reference_peak_at) == ("p7", "p5")
        assert not weak.agrees
        assert not moved.agrees
        assert validate(line(), TRUTH).agrees

    @given(st.floats(1e-9, 1e9))
    def test_no_unit_matters(self, unit):
        found = TRUTH + 0.03 * np.sin(9 * X)
        one, other = (
            validate(line(s * found, std=np.full(P, s * 0.05)), s * TRUTH).checks[0] for s in (1.0, float(unit))
        )
        assert (other.error, other.shape, other.gain, other.band) == pytest.approx(
            (one.error, one.shape, one.gain, one.band)
        )

    def test_areas_weigh(self):
        """A patch of ten times the length counts ten times in the integral."""
        found = TRUTH.copy()
        found[0] += 1
        e = line(found)
        wide = dict(e.geometry) | {"measures": np.r_[10.0, np.ones(P - 1)]}
        w = wide["measures"]
        (check,) = validate(replace(e, geometry=wide), TRUTH).checks
        assert check.error == pytest.approx(np.sqrt(w @ (found - TRUTH) ** 2 / (w @ TRUTH**2)))

    def test_nodal_forces_are_not_weighed_by_areas(self):
        e = line(np.where(X < 0.1, TRUTH + 1, TRUTH), kind="nodal", units=["N"] * P)
        e = replace(e, geometry=dict(e.geometry) | {"measures": np.r_[10.0, np.ones(P - 1)]})
        (check,) = validate(e, TRUTH).checks
        assert check.error == pytest.approx(1 / np.linalg.norm(TRUTH))

    def test_units_are_converted_or_refused(self):
        assert validate(line(), Known(TRUTH / 1e3, unit="kN/m")).checks[0].error < 1e-12
        with pytest.raises(InputError, match="another unit"):
            validate(line(), Known(TRUTH, unit="Pa"))

    def test_units_are_kept_apart(self):
        e = line(units=["N/m"] * 6 + ["N"] * 6)
        assert [c.unit for c in validate(e, TRUTH).checks] == ["N/m", "N"]

    def test_std_of_the_reference_widens_the_band(self):
        found = TRUTH + 0.15
        bare, wide = (validate(line(found), Known(TRUTH, std=s)).checks[0].band for s in (None, 0.1))
        assert (bare, wide) == (0, 1)

    def test_bad_references(self):
        for reference, words in (
            (TRUTH[:-1], "does not fit"),
            (np.where(X > 0.9, np.nan, TRUTH), "NaN"),
            (0 * TRUTH, "zero"),
            (["a"] * P, "no real numbers"),
            (TRUTH * 1j, "complex"),
            (Known(TRUTH, std=-1.0), "not positive"),
            (Known(TRUTH[:3], loads=["p1", "p2", "none"]), "no such load"),
            (Record(np.ones((5, P)), 1.0), "no channel of the record"),
            (lambda x: np.ones(3), "another number of values"),
        ):
            with pytest.raises(InputError, match=words):
                validate(line(), reference)
        with pytest.raises(InputError, match="nothing to validate"):
            validate(line())
        with pytest.raises(InputError, match="no estimate"):
            validate(TRUTH, TRUTH)
        with pytest.raises(InputError, match="no probability"):
            validate(line(), TRUTH, level=1.5)


class TestFields:
    def test_a_function_is_averaged_over_patches(self):
        (check,) = validate(line(), lambda x: x**4).checks
        edges = np.linspace(0, 1, P + 1)
        mean = np.diff(edges**5) / 5 * P
        assert check.error == pytest.approx(np.linalg.norm(TRUTH - mean) / np.linalg.norm(mean))
        assert validate(line(mean), lambda x: x**4).checks[0].error < 1e-12

    def test_a_function_is_averaged_over_rectangles(self):
        """Patches 1/3 by 1/4 of the unit square; the mean of x^3 y^2 is a product of integrals."""
        i, j = np.divmod(np.arange(P), 4)
        boxes = np.stack([np.stack([i, i + 1], -1) / 3, np.stack([j, j + 1], -1) / 4], axis=1)
        x, y = boxes[:, 0], boxes[:, 1]
        mean = np.diff(x**4 / 4)[:, 0] * 3 * np.diff(y**3 / 3)[:, 0] * 4
        e = line(mean)
        own = {"coordinates": boxes.mean(axis=2), "extents": boxes, "measures": np.full(P, 1 / 12)}
        e = replace(e, geometry=dict(e.geometry) | own)
        assert validate(e, lambda q: q[:, 0] ** 3 * q[:, 1] ** 2).checks[0].error < 1e-12

    def test_a_function_is_taken_at_hats(self):
        assert validate(line(X**4, kind="hats"), lambda x: x**4).checks[0].error < 1e-12

    def test_fe_truth_on_a_finer_mesh(self):
        fine = np.linspace(0, 1, 1201)
        fine = (fine[1:] + fine[:-1]) / 2
        edges = np.linspace(0, 1, P + 1)
        mean = np.diff(np.sin(3 * edges) / 3) * P
        assert validate(line(mean), (fine, np.cos(3 * fine))).checks[0].error < 1e-6

    def test_points_beside_the_patches_are_left_out(self):
        """A reference over more than the basis: the last patch must not take what lies outside."""
        fine = np.linspace(-1, 2, 3601)
        inside = (fine > -1e-9) & (fine < 1 + 1e-9)
        found = validate(line(np.ones(P)), (fine, np.where(inside, 1.0, 50.0)))
        assert found.checks[0].error < 1e-12
        assert validate(line(np.ones(P)), (fine[inside], np.ones(inside.sum()))).checks[0].error < 1e-12

    def test_a_coarser_mesh_is_interpolated(self):
        coarse = np.array([0.0, 1.0, 0.5])
        assert validate(line(2 + X), (coarse, 2 + coarse)).checks[0].error < 1e-12

    def test_beyond_the_reference(self):
        half = np.linspace(0, 0.5, 4)
        with pytest.raises(InputError, match="6 of 12 places"):
            validate(line(), (half, half))
        found = validate(line(np.where(X < 0.5, X, 0)), Known(half, coordinates=half, outside=0.0))
        assert found.checks[0].error < 1e-12

    @pytest.mark.parametrize("turn", [0, 1])
    def test_a_surface_in_space(self, turn):
        """Places on a plane, tilted or not; linear fields are reproduced by interpolation."""
        rng = np.random.default_rng(0)
        frame = np.linalg.qr(rng.standard_normal((3, 3)))[0] if turn else np.eye(3)
        inner = np.column_stack([rng.uniform(0.1, 0.9, (P, 2)), np.zeros(P)])
        outer = np.column_stack([rng.uniform(0, 1, (60, 2)), np.zeros(60)])
        outer[:4, :2] = [[0, 0], [1, 0], [0, 1], [1, 1]]
        value = lambda q: 1 + 2 * q[:, 0] - q[:, 1]  # noqa: E731
        e = line(value(inner), kind="hats")
        e = replace(e, geometry=dict(e.geometry) | {"coordinates": inner @ frame})
        assert validate(e, (outer @ frame, value(outer))).checks[0].error < 1e-9
        with pytest.raises(InputError, match="no common line or plane"):
            validate(e, (outer @ frame + rng.standard_normal((60, 3)), value(outer)))

    def test_components(self):
        both = np.column_stack([TRUTH, 0.1 * TRUTH]).ravel()
        e = line(both, components=("+X", "+Z"))
        assert validate(e, lambda x: np.column_stack([np.ones_like(x), x])).checks[0].what == "24 loads"
        (normal,) = validate(e, Known(0.1 * TRUTH, loads="Z")).checks
        assert normal.error < 1e-12
        assert normal.what == "12 loads"
        with pytest.raises(InputError, match="name the component"):
            validate(e, lambda x: x)

    def test_nodal_forces_are_compared_as_tractions(self):
        """Consistent forces of a linear line load: the boundary mass of two-node elements turns them back."""
        h = 1 / (P - 1)
        x = np.linspace(0, 1, P)
        M = h * (np.eye(P) * np.r_[1, [2] * (P - 2), 1] / 3 + (np.eye(P, k=1) + np.eye(P, k=-1)) / 6)
        T = np.linalg.solve(M, np.eye(P))
        e = line(M @ (1 + x), kind="nodal", units=["N"] * P)
        e = replace(e, geometry=dict(e.geometry) | {"traction": T, "coordinates": x[:, None]})
        (check,) = validate(e, Known(lambda x: (1 + x) / 1e3, unit="kN/m")).checks
        assert check.error < 1e-12
        assert check.unit == "N/m"
        assert check.band == 1
        with pytest.raises(InputError, match="places"):
            validate(replace(e, geometry=None), (x, x))

    def test_polynomials_have_no_places(self):
        with pytest.raises(InputError, match="no places"):
            validate(line(kind="polynomials"), lambda x: x)


class TestHistories:
    def test_arrays_functions_and_records_agree(self):
        e = impact()
        t = e.axis.values
        pulse = np.where((t >= 0.01) & (t <= 0.012), 1000 * np.sin(np.pi * (t - 0.01) / 0.002), 0)
        by_record = Record(np.r_[pulse, 0, 0] / 1e3, e.axis.step, [Channel(label="hammer", quantity="force", unit="N")])
        by_record = Record(by_record.values * 1e3, e.axis.step, by_record.channels)
        found = [
            validate(e, r).checks[0]
            for r in (pulse, pulse[:, None], lambda t: np.interp(t, e.axis.values, pulse), by_record)
        ]
        assert len({(c.error, c.gain, c.band, c.peak_distance) for c in found}) == 1
        assert found[0].error == pytest.approx(np.linalg.norm(e.load[:, 0] - pulse) / np.linalg.norm(pulse))
        assert found[0].distance_unit == "s"
        assert found[0].band > 0.9

    def test_one_load_of_two(self):
        e = impact(2)
        reference = Record(e.load[:, 1], e.axis.step, [e.labels[1]])
        (check,) = validate(e, reference).checks
        assert check.error == 0
        assert validate(e, Known(e.load[:, 1], loads=e.labels[1])).checks[0].error == 0

    def test_another_step_or_too_short(self):
        e = impact()
        for record in (Record(e.load, 2 * e.axis.step, e.labels), Record(e.load[:-1], e.axis.step, e.labels)):
            with pytest.raises(InputError, match="does not fit"):
                validate(e, record)
        with pytest.raises(InputError, match="does not fit"):
            validate(e, e.load[:5])

    def test_frames_share_a_static_truth(self):
        e = line(np.stack([TRUTH, 1.1 * TRUTH]))
        (check,) = validate(e, TRUTH).checks
        assert check.what == "12 loads x 2"
        assert check.gain == pytest.approx(1.05)


# -- pressure mats -----------------------------------------------------------------------------------------------------
class TestMat:
    P4 = np.kron(np.eye(4), np.full(3, 1 / 3))

    def test_cells_are_averages(self):
        wiggle = np.tile([1.0, -2.0, 1.0], 4)  # invisible to the mat
        found = validate(line(TRUTH + wiggle), PressureMat(self.P4, self.P4 @ TRUTH))
        assert found.level == "distribution"
        assert found.checks[0].error < 1e-12
        assert found.checks[0].what == "4 averages"
        assert found.flags == ()
        assert validate(line(TRUTH + wiggle), TRUTH).checks[0].error > 1

    def test_the_band_of_averages_knows_correlations(self):
        """Errors that cancel in a cell: the band of the average is narrower than that of the loads."""
        anti = np.kron(np.eye(4), np.eye(3) - 1 / 3)
        e = line(posterior=Flat(0.05**2 * anti))
        shifted = self.P4 @ TRUTH + 1e-3
        assert validate(e, PressureMat(self.P4, shifted)).checks[0].band == 0
        assert validate(line(), PressureMat(self.P4, shifted)).checks[0].band == 1
        assert validate(e, PressureMat(self.P4, shifted, std=1e-3)).checks[0].band == 1

    def test_a_mat_of_few_cells_is_a_resultant(self):
        found = validate(line(), PressureMat(self.P4[:2], self.P4[:2] @ TRUTH))
        assert found.level == "resultant"
        assert [f.code for f in found.flags] == ["LID-N701"]

    def test_refused(self):
        for mat, words in (
            (PressureMat(self.P4[:, :-1], np.ones(4)), "averaging matrix does not fit"),
            (PressureMat(self.P4, np.ones(3)), "does not fit the estimate"),
            (PressureMat(self.P4, [1, np.nan, 1, 1]), "NaN"),
            (PressureMat(self.P4, np.ones(4), unit="N"), "another unit"),
        ):
            with pytest.raises(InputError, match=words):
                validate(line(), mat)
        with pytest.raises(InputError, match="different units"):
            validate(line(units=["N/m"] * 6 + ["N"] * 6), PressureMat(self.P4, np.ones(4)))


# -- resultants --------------------------------------------------------------------------------------------------------
class TestResultant:
    def test_numbers(self):
        rng = np.random.default_rng(1)
        A = rng.standard_normal((P, P))
        e = line(posterior=Flat(A @ A.T))
        value, std = C @ TRUTH + [0.5, -0.2], np.array([0.3, 0.1])
        found = validate(e, ReferenceWrench(value, std))
        (check,) = found.checks
        expected = np.sqrt(np.diag(C @ A @ A.T @ C.T) + std**2)
        assert check.sd == pytest.approx(np.array([0.5, 0.2]) / expected)
        assert check.error == pytest.approx(np.array([0.5, 0.2]) / np.abs(value))
        assert check.units == ("N", "N m")
        assert found.level == "resultant"

    def test_a_stated_bias_is_a_floor_of_the_std(self):
        bias = np.full(P, 0.3)
        value = C @ TRUTH + 0.1
        (check,) = validate(line(bias=bias), ReferenceWrench(value)).checks
        assert check.sd == pytest.approx(0.1 / (C @ bias))

    def test_a_match_is_partial(self):
        """Another map with the same force and moment: the resultant is right to rounding, the map is not."""
        kernel = np.linalg.svd(C)[2][-1]
        found = validate(line(TRUTH + 2 * kernel), ReferenceWrench(C @ TRUTH, std=0.01))
        assert found.agrees
        assert found.partial
        (flag,) = found.flags
        assert (flag.code, flag.level) == ("LID-N701", "note")
        assert flag.evidence.value == 2
        assert flag.evidence.threshold == P
        assert "Necessary, not sufficient: infinitely many maps share this resultant" in str(found)
        assert "partial" in str(found)
        both = validate(line(TRUTH + 2 * kernel), ReferenceWrench(C @ TRUTH, std=0.01), TRUTH)
        assert both.level == "distribution"
        assert both.flags == ()
        assert not both.agrees

    @pytest.mark.parametrize(
        ("levels", "numbers", "raised"),
        [
            (("resultant",), 2, True), (("resultant", "held-out sensors"), 2, True), (("resultant",), P, False),
            (("resultant", "distribution"), 2, False), (("held-out sensors",), 0, False), ((), 0, False),
        ],
    )  # fmt: skip
    def test_the_guard(self, levels, numbers, raised):
        assert (resultant_only(levels, numbers, P) is not None) == raised

    def test_one_force_is_its_own_resultant(self):
        e = impact()
        value = e.load[:, :1] + 1
        found = validate(e, ReferenceWrench(value, C=np.ones((1, 1)), labels=["F"]))
        assert found.level == "resultant"
        assert found.flags == ()

    def test_labels_pick_rows_and_units_convert(self):
        (check,) = validate(line(), ReferenceWrench([(C @ TRUTH)[1] / 1e3], labels=["M"], units=["kN*m"])).checks
        assert check.labels == ("M",)
        assert check.error[0] < 1e-12

    def test_frames(self):
        load = np.stack([TRUTH, 2 * TRUTH, 0 * TRUTH])
        e = line(load, posterior=Flat(0.01 * np.eye(P)))
        value = load @ C.T * 1.1
        (check,) = validate(e, ReferenceWrench(value)).checks
        assert check.at == 1
        assert check.error == pytest.approx([0.1 / 1.1] * 2)
        sd = np.sqrt(np.mean((0.1 * load @ C.T / np.sqrt(0.01 * np.sum(C**2, axis=1))) ** 2, axis=0))
        assert check.sd == pytest.approx(sd)

    def test_a_zero_moment_is_judged_by_its_std(self):
        """A force without moment about the point: no relative error, still three sd."""
        Cz = np.vstack([C[0], C[1] - (C[1] @ TRUTH) / (C[0] @ TRUTH) * C[0]])
        e = line()
        e = replace(e, geometry=dict(e.geometry) | {"resultant": Cz})
        (check,) = validate(e, ReferenceWrench([C[0] @ TRUTH, 0.0], std=[0.01, 0.01])).checks
        assert check.error[1] is None
        assert check.agrees
        assert "M" in str(check)

    def test_a_constraint_is_a_wrench(self):
        class Constraint:
            value, covariance, labels = C @ TRUTH, np.diag([4e-4, 1e-4]), ("F", "M")

        Constraint.C = C
        e = line(provenance={"settings": {"constraint_kinds": ["Resultant"]}})
        found = validate(e, Constraint())
        assert found.checks[0].sd == (0.0, 0.0)
        assert {f.code for f in found.flags} == {"LID-N701", "LID-W704"}

    def test_refused(self):
        for wrench, words in (
            (ReferenceWrench([1.0]), "does not fit"),
            (ReferenceWrench([1.0], labels=["Fx"]), "no such resultant"),
            (ReferenceWrench([1.0, np.nan]), "NaN"),
            (ReferenceWrench([1.0, 1.0], std=[0.1, 0.0]), "not positive"),
            (ReferenceWrench([0.0, 0.0]), "zero"),
            (ReferenceWrench([1.0], C=np.ones((1, 3))), "do not fit"),
            (ReferenceWrench([1.0, 1.0], units=["N"]), "do not fit"),
            (ReferenceWrench([1.0, 1.0], units=["N", "kg"]), "another unit"),
        ):
            with pytest.raises(InputError, match=words):
                validate(line(), wrench)
        with pytest.raises(InputError, match="give C"):
            validate(replace(line(), geometry=None), ReferenceWrench([1.0, 1.0]))


# -- held-out sensors of static loads ----------------------------------------------------------------------------------
class TestStaticHeldOut:
    H = np.random.default_rng(3).standard_normal((3, P))

    def model(self, noise=None, loads=None):
        rows = [Channel(label=f"v{i}", quantity="displacement", unit="m", noise=noise) for i in range(3)]
        return MatrixModel(self.H, sensors=rows, loads=loads or [f"p{i}" for i in range(P)])

    def test_one_reading(self):
        measured = self.H @ TRUTH + [0.1, 0, -0.2]
        out = held_out(line(), self.model(noise=0.1), measured)
        assert out.predicted == pytest.approx(self.H @ TRUTH)
        assert out.error == pytest.approx(np.array([0.1, 0, 0.2]) / np.sqrt(np.mean(measured**2)), abs=1e-12)
        assert out.noise_ratio == pytest.approx([1, 0, 2], abs=1e-12)
        found = validate(line(), out)
        assert found.level == "held-out sensors"
        assert found.partial
        assert found.agrees
        assert "2 times the noise (v2)" in str(found)

    def test_loads_in_another_order(self):
        back = MatrixModel(self.H[:, ::-1], sensors=["v0", "v1", "v2"], loads=[f"p{i}" for i in range(P)][::-1])
        assert held_out(line(), back, self.H @ TRUTH).error == pytest.approx([0, 0, 0], abs=1e-12)

    def test_frames_and_records(self):
        load = np.outer(np.arange(1.0, 10), TRUTH)
        out = held_out(line(load), self.model(), 1.1 * load @ self.H.T)
        assert out.error == pytest.approx([0.1 / 1.1] * 3)
        record = Record(np.tile(self.H @ TRUTH, (50, 1)), 1e-2, self.model().sensors)
        assert held_out(line(), self.model(), record).error == pytest.approx([0, 0, 0], abs=1e-12)

    def test_a_shared_channel(self):
        e = line(sensors=["v1"], sensor_units=["m"], response=np.ones(1), residual=np.zeros(1))
        out = held_out(e, self.model(), self.H @ TRUTH)
        assert [f.code for f in out.flags] == ["LID-W704"]
        assert [f.code for f in validate(e, out).flags] == ["LID-W704"]

    def test_refused(self):
        for readings, words in (
            (np.ones(2), "do not fit"),
            ([1, np.nan, 2], "NaN"),
            (np.ones(3) * 1j, "no real numbers"),
            (np.ones((1, 1, 3)), "do not fit"),
            (np.zeros(3), "zero"),
            (Record(np.ones((9, 2)), 1.0, ["v0", "v1"]), "no channel"),
        ):
            with pytest.raises(InputError, match=words):
                held_out(line(), self.model(), readings)
        with pytest.raises(InputError, match="different loads"):
            held_out(line(), MatrixModel(self.H[:, :3]), np.ones(3))


# -- what travels ------------------------------------------------------------------------------------------------------
def everything():
    out = held_out(line(), MatrixModel(TestStaticHeldOut.H), TestStaticHeldOut.H @ TRUTH)
    return validate(
        line(), out, ReferenceWrench(C @ TRUTH * 1.01), PressureMat(TestMat.P4, TestMat.P4 @ TRUTH), TRUTH * 1.3
    )


def test_a_validation_survives_a_file(tmp_path):
    whole = everything()
    partial = validate(line(), ReferenceWrench(C @ TRUTH, std=0.1))
    for found in (whole, partial, Validation()):
        storage.write(tmp_path / "v.h5", found.to_dict(), "validation")
        back = Validation.from_dict(storage.read(tmp_path / "v.h5", "validation"))
        assert back == found
        assert str(back) == str(found)
    assert whole.level == "distribution"
    assert len(whole.checks) == len(whole.sensors) + len(whole.resultants) + len(whole.distributions) == 4


def test_a_validation_of_an_earlier_release_is_read():
    partial = validate(line(), ReferenceWrench(C @ TRUTH, std=0.1))
    tree = partial.to_dict()
    tree["checks"][0]["found"] = tree["checks"][0].pop("estimated")
    assert Validation.from_dict(tree) == partial


def test_the_estimate_keeps_it(tmp_path):
    e = line(posterior=None).validated(validate(line(), ReferenceWrench(C @ TRUTH, std=0.1)))
    assert "N701" in e.codes
    assert e.validation.level == "resultant"
    e.save(tmp_path / "e.h5")
    assert LoadEstimate.read(tmp_path / "e.h5").validation == e.validation


def test_words():
    found = everything()
    assert str(Validation()) == "level: none"
    assert str(found).startswith("level: distribution, disagrees. ")
    lines = found.table().splitlines()
    assert lines[0] == "level reached: distribution"
    assert len(lines) == 5
    assert [line.split()[0] for line in lines[1:]] == ["held-out", "resultant", "distribution", "distribution"]
    with pytest.raises(AttributeError):
        found.checks = ()


def test_complex_loads_are_refused():
    e = LoadEstimate(load=np.ones((2, 1)) * 1j, std=np.ones((2, 1)), labels=["a"], units=["N"],
                     axis=Axis("frequency", "Hz", np.arange(2.0)))  # fmt: skip
    with pytest.raises(InputError, match="complex"):
        validate(e, np.ones((2, 1)))
