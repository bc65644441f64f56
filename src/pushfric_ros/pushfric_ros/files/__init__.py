"""Input files: object, cell, push plan, observations and estimator settings."""
