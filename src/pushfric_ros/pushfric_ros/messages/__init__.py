"""Core types to ROS messages and back, markers, the installed message types, and the qualities of service."""
