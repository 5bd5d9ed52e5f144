"""The paper's experiments on a virtual rig, beside its numbers."""
