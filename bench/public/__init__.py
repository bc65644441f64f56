"""Public data sets of real pushes, read from their own formats."""
