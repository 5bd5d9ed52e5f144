"""How much more a designed excitation tells than steps, and whether it keeps its limits, on simulated joints."""
