"""Sparse histories: l1 and group penalties over dictionaries, solved to a stated duality gap."""
