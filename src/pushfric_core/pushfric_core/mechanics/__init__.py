"""What a pushed object does: quasi-static motion, limit surfaces, predictions and stable pushes, with and without a spread."""
