"""Bags: writing, checking, reading and recovering them, and the data points in them."""
