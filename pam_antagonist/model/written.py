"""Modules that this package writes: effects put together, and the equations for lanes.

They lie in the folder of the compiled kernels, so that a kernel of an earlier process finds those of which it is made.
"""

from pam_antagonist._jit import cache_dir

__path__ = [str(cache_dir())]
