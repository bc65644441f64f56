"""Bags, and the data points in them."""
