"""The gel pad as finite elements, from its table to its stiffness."""
