"""What simulators and planners read: a friction model as MJCF, SDF, URDF, a Drake directive, JSON, or a planner's YAML."""
