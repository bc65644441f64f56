"""What moves the tip: the protocol of a pusher, the GRBL driver, strokes in pieces, and what is kept of a position."""
