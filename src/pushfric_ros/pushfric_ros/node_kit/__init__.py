"""What every node needs: parameters, a clean start and end, diagnostics, heartbeats, the network, /tf, visits."""
