"""Bodies in the messages of other trackers and robots (PoseStamped, TF)."""
