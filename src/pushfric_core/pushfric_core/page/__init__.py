"""The page of a run, live, from a bag or as a report in one file; and pages on which a person works over a picture."""
