"""Planar poses and vectors, outlines, contacts, supports, the objects of Table 1, and the names of frames."""
