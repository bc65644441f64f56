"""What moves the tip: its protocol, the driver of GRBL, tables of states, and the memory of the last position."""
