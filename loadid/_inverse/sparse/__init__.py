"""Sparse histories: l1 and group penalties over dictionaries, solved to a stated duality gap."""

TOLERANCE = 1e-6  # duality gap of an answer, over 1/2 |y|^2
