"""The Python API: what the commands do, as functions. Its names are imported from ``pam_antagonist`` itself."""
