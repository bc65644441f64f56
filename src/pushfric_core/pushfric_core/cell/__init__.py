"""A cell: its file, the settings of its nodes, and the drivers that it chooses."""
