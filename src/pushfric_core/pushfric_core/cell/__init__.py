"""A cell: its file, the settings of its nodes, the drivers that it chooses, and how tracked bodies are mounted."""
