"""What every node needs: parameters, a clean start and end of its process, diagnostics, memory for images, /tf, visits."""
