"""What moves the tip: the protocol of a pusher, the GRBL driver, strokes in pieces, and the memory of the last position."""
