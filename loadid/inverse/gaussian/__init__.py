"""Linear-Gaussian systems: exact Tikhonov over whole records in O(N), filters and smoothers of loads with priors."""
