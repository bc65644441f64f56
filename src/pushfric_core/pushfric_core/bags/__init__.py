"""Bags: writing, checking, reading and recovering them, and the observations in them."""
