"""What the search for the place of a load stands on: the candidates, their grid, their models."""
