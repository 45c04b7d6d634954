"""Closed forms: layers, half-spaces, presses, contacts."""
