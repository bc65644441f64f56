"""Reports on an estimate for people and programs: JSON, figures, and the frame of pages."""
