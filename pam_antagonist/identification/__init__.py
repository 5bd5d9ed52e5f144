"""Parameters of a rig from its recordings."""
