"""Loads of a running structure from a stream of samples: a growing file, standard input, a socket."""

from __future__ import annotations

from .follow import StreamSummary, follow
from .sources import open_source

__all__ = ["StreamSummary", "follow", "open_source"]
