"""The linear and quadratic programs for w, what solves them, and what certifies the result."""
