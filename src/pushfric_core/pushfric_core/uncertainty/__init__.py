"""How certain an estimate is: what the data leave open, mu_c with its interval, outliers, and the geometry check."""
