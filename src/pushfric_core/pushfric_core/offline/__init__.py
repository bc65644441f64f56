"""Work on files, without a graph: estimates of one input or hundreds, the page of a run, images tracked again."""
