"""The nodes of the graph, and the command line's monitor: message in, core called, result published."""
