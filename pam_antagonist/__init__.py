"""Sensor-less angle and torque of a joint that is driven by two pneumatic artificial muscles."""

__version__ = "0.1.0"
