"""The nodes of the graph, and the command line's monitor: a message comes in, the core is called, the result is published."""
