"""How well the torque from outside is estimated, on simulated joints that are pushed."""
