"""How certain an estimate is: the confidence ellipse, the interval of mu_c, outliers, and the geometry check."""
