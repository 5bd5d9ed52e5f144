"""The fault matrix: what goes wrong on purpose in a running pipeline, and what the valves, diagnostics and nodes do."""
