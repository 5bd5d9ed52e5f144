"""The Python API: the commands as functions. Import its names from ``pam_antagonist``."""
