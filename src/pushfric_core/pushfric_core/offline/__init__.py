"""Estimation from files, without a graph: one input, or hundreds of them on many processes."""
