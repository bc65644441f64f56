"""A friction model for simulators and planners: MJCF, SDF or JSON."""
