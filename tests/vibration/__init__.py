"""The vibration laboratory."""
