"""The physics of the joint, muscles, chambers and valves: numpy and numba only, one file a domain.

In compiled functions `p` is a parameter vector (P,), and `i`, `muscle` and `valve` are 0 or 1.
"""
