"""Faults caused on purpose: what is done, when, and what must follow; the table of a moving pusher."""
