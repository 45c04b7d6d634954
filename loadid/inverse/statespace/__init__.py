"""Exact Tikhonov over whole records in O(N), for models that are discrete state spaces."""
