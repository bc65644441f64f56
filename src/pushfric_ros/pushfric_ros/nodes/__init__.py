"""The seven nodes: message -> one call of the core -> publish."""
