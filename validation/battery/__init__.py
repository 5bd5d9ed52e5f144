"""How often the diagnosis is right, on simulated joints whose effects are known."""
