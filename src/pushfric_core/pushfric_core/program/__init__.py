"""The linear program of an estimate: its terms and constraints (sections 3 and 4)."""
