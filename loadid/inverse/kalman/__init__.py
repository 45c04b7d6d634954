"""Filters of structures with unknown loads: priors of loads, square-root recursions, steady gains, smoothing."""
