"""Sensors that turn motion of markers into force maps."""
