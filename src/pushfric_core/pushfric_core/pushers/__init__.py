"""Pushers, which move the tip: their common driver, serial line, dialects, tables of states, memory of the last position."""
