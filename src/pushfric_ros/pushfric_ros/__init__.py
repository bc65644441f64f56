"""The robot cell around pushfric_core: rclpy nodes, drivers, bags, command line."""
