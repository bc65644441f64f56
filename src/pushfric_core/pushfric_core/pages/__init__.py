"""Pages that a browser shows: their server, and what a person clicks or draws there over a picture."""
