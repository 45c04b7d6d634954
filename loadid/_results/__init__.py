"""The answer as data: estimates, their facts and numbers, archive, summary and report."""
