"""The live view: what a run has shown so far, and the server of the page that shows it."""
