"""Friction parameters of pushed objects (Lynch 1993): pure maths, no ROS, no files, no clocks."""
