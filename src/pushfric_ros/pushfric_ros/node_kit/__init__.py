"""What any node needs: parameters, process, diagnostics, memory for images, /tf."""
