"""Constrained paths: feasible sets, active sets, interior points; loads that only push, over whole records."""
