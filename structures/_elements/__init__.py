"""Finite elements: beams, frames, plates, circular plates, chains, solids."""
