"""Public data sets of real pushes: their own formats, as bags or as CSV files."""
