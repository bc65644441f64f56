"""The node graph, defined once, and the ways to start it."""
