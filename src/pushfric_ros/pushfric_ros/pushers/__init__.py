"""What moves the tip: the protocol of a pusher, and its drivers."""
