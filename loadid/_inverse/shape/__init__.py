"""Deflections of a plate as Gaussian radial basis functions, and the load that its equation of motion makes of them."""
