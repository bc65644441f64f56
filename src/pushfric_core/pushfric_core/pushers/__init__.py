"""What moves the tip: the protocol of a pusher, the GRBL driver, tables of states, and the memory of the last position."""
