"""A cell: its file, the settings of its nodes, its drivers, and how tracked bodies are mounted."""
