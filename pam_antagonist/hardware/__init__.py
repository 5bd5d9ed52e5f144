"""Real hardware: serial protocol, device, clocks, calibration, and an emulated device (without ROS)."""
