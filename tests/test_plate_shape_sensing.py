"""Case study `plate_shape_sensing`: what its table says, on one draw that it does not print."""

from __future__ import annotations

import pytest

from case_studies import plate_shape_sensing as study


@pytest.fixture(scope="module")
def rows():
    return [*study.gauged(11), *study.full_field(11)]


def test_the_shape_route_errs_least(rows):
    shape, transfer, full, whole = (row.error for row in rows)
    assert shape < 0.05  # least squares with 16 true modes: 0.050
    assert transfer < 0.30
    assert full < 0.20
    assert shape < min(transfer, full) / 2
    assert whole < 0.05


def test_the_bands(rows):
    assert rows[0].covered > 0.75
    assert rows[1].covered > 0.90
    assert rows[2].covered > 0.80
    assert rows[3].covered > 0.85
