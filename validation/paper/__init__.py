"""The paper's experiments on a virtual rig, each beside the paper's own numbers.

The virtual rig is this package's simulator with declared mismatches (``config/scenarios/paper.yaml``): agreement with
it says how estimator and models compare, and nothing about a real joint.
"""
