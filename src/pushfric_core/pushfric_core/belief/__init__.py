"""The belief about an object's friction, with its uncertainty: one likelihood, of whole pushes."""
