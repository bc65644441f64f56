"""Shared by all nodes: parameters, a clean start and end, diagnostics, heartbeats, the network, /tf."""
