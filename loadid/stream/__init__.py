"""Loads of a running structure from a stream of samples: a growing file, standard input, a socket."""

from __future__ import annotations

from .follow import Followed, follow
from .sources import open_source

__all__ = ["Followed", "follow", "open_source"]
