"""The linear and quadratic programs for w, and what solves them."""
