"""A joint without hardware: the simulated plant and the voltages that excite it."""
