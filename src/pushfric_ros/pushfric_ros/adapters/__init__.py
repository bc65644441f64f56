"""What other trackers and robots publish (PoseStamped, Odometry, PoseArray, TF), as bodies in space."""
