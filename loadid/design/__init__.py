"""Sensor layouts judged and chosen before anything is measured."""

from __future__ import annotations

from .comparison import LayoutComparison, compare
from .layout import Judged
from .placement import Placement, place

__all__ = ["Judged", "LayoutComparison", "Placement", "compare", "place"]
