"""Pushers, which move the tip: their protocol, the driver of GRBL, tables of states, and the memory of the last position."""
