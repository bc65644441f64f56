"""The simulated cell's camera and motion controller."""
