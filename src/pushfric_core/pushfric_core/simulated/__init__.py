"""The simulated cell's camera and its GRBL controller; a Marlin controller for tests."""
