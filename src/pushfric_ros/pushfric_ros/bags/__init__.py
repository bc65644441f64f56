"""MCAP bags: writing, reading and recovering them, and the data points in them."""
