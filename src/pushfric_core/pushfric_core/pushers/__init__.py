"""Pushers, which move the tip: their common driver, the serial line, GRBL, tables of states, memory of the last position."""
