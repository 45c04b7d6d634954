"""Finite-element models of other programs: matrices, meshes and modes from their files."""
