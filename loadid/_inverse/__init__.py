"""The shared mathematics of all families: problems, penalties, paths, rules, diagnostics. No physics."""
