"""What people read of an estimate: JSON and figures."""
