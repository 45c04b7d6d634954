"""Loads that only push, over records of any length: non-negative Tikhonov with a duality gap, O(N) for each step."""
