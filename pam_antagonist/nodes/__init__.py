"""Thin ROS 2 nodes around the ROS-free packages. Importing this package imports no rclpy; its modules do."""
