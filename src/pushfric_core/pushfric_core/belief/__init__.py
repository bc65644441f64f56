"""What is believed of an object's friction, and doubted of the data: one likelihood, of whole pushes."""
