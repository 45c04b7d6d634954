"""Tikhonov behind impulse responses of any length, by FFT products and conjugate gradients; candidate places."""
