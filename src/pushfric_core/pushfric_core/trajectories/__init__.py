"""From stamped poses, pusher states and forces to observations, with an account of every message."""
