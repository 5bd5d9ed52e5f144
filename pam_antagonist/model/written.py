"""Modules that this package generates: the composed effects, and the equations for lanes.

Their files are kept with the compiled kernels, so that a kernel of an earlier process finds the functions it calls.
"""

from pam_antagonist._jit import cache_dir

__path__ = [str(cache_dir())]
