"""Sensor layouts judged and chosen before anything is measured.

The classes of the answers can be imported for types; nobody makes them by hand.
"""

from ._comparison import LayoutComparison as LayoutComparison
from ._comparison import compare
from ._hitplacement import place_for_hits
from ._layout import Judged as Judged
from ._placement import Placement as Placement
from ._placement import place

__all__ = ["compare", "place", "place_for_hits"]
