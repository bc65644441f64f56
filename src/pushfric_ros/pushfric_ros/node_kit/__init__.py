"""Shared by all nodes: parameters, qualities of service, a clean start and end, diagnostics, heartbeats, the network, /tf."""
