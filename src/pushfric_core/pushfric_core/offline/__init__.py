"""Work on files, without a graph: estimates of one input or hundreds, and images tracked again."""
