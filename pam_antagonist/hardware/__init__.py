"""Real hardware: the serial protocol, its device, clocks, calibration, and a device to practise on (no ROS in here)."""
