"""The estimator, its estimate and verdict, recognition of objects, the region of p_CF, and which push to do next."""
