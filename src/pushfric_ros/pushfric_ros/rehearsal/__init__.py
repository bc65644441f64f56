"""Faults caused on purpose while a controller moves: how soon the pusher rests, and how far it goes."""
