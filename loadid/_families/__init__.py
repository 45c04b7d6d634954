"""The families of the method map: each poses a linear problem, chooses lambda on its path, and says what it knows."""
