"""Commands of the tactile package, registered under the entry-point group ``loadid.commands``.

Modules here are imported for every command line, so they import what is heavy inside functions.
"""

from __future__ import annotations
