"""Recordings of joints with something wrong."""

from recorded_joints import experiment_of, recorded

__all__ = ["experiment_of", "recorded"]
