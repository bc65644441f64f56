"""Core types <-> ROS messages, their types, their qualities of service."""
