"""Faults brought about on purpose, with a controller that moves: how fast the pusher rests, and how far it goes."""
