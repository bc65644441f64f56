"""Reports on an estimate for people and programs: JSON and figures."""
