"""Pages that a browser shows: their servers, that of a run among them, and what a person clicks or draws over a picture."""
