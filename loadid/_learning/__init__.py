"""Maps from readings to loads that were learned from examples: what is common to every engine that learns one."""
