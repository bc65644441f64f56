"""Input files: objects, push plans, observations, saved models and the settings of an estimate."""
