"""Many frequency lines at once: compressed, with a prior from the neighbouring lines, or with a rule for each line."""
