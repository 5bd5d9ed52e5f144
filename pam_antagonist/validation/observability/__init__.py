"""What can be known of angle and torque from outside, by which sensor, from the model alone."""
