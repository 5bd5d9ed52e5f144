"""A device for the bridge: the reference firmware on a pseudo-terminal, a simulated joint, and faults of the line."""
