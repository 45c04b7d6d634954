"""The rooms of frequency inversion: what comes in, how its lines are solved, how far the rules agree."""
