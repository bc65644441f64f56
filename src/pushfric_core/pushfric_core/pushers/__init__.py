"""What moves the tip: the protocol of a pusher, the GRBL driver, the tables of their states, and the memory of the last position."""
