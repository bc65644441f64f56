"""What moves the tip: its protocol, the drivers of GRBL and Marlin, tables of states, and the memory of the last position."""
