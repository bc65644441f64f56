"""What people hand in: object, cell, push plan, observations and estimator settings."""
