"""Sensor layouts judged and chosen before anything is measured."""

from __future__ import annotations

from ._comparison import LayoutComparison, compare
from ._layout import Judged
from ._placement import Placement, place

__all__ = ["Judged", "LayoutComparison", "Placement", "compare", "place"]
