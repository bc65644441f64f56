"""Work on files, without a graph: estimates of one input or hundreds, images tracked again, known loads."""
