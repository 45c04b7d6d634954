"""The answer: estimates, their numbers, archive, summary and report."""
