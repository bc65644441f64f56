"""Bodies in the messages of other trackers and robots (PoseStamped, Odometry, PoseArray, TF)."""
