"""Core types to ROS messages and back, markers, and the installed message types."""
