"""Reports on an estimate for people and programs: JSON, figures, and pages, that of a run among them."""
