"""The simulated cell's camera and its GRBL controller."""
