"""A friction model for simulators and planners: MJCF, SDF, URDF, a Drake directive, JSON, or a planner's YAML."""
