"""Guards of the tactile route: one module for each room."""
