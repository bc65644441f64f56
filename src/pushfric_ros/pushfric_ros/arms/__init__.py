"""Robot arms as pushers: the tip is followed by its pose, and steered along the pushing line."""
