"""What people read: JSON and figures."""
