"""Tikhonov deconvolution of long records behind impulse responses, by FFT products and conjugate gradients."""
