"""The belief about an object's friction, and doubts about the data: one likelihood, of whole pushes."""
