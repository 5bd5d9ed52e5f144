"""How well the laws of control do on simulated joints, sensor-less: steps, random references with pushes, yielding."""
