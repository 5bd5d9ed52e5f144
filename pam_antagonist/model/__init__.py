"""The physics of the joint, muscles, chambers and valves: numpy and numba only, one file a domain."""
