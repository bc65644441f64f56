"""The live view: what is so at present."""
