"""What moves the tip: the protocol of a pusher, and the GRBL driver."""
