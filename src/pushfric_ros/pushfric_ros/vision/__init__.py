"""From an image to the object's pose."""
