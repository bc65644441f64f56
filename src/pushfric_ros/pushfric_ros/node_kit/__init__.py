"""What every node needs: parameters, a clean start and end, diagnostics, heartbeats, memory for images, /tf, visits."""
