"""The live view: the server of the page that shows a run, and what is so at present."""
