"""Contact force maps from pad and camera: an application of `structures` and `loadid`."""
