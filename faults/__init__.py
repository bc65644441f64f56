"""The campaign of faults: what is done to a running cell, what must follow, and what did follow."""
