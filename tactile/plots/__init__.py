"""Pictures of the tactile package."""
