"""Commands. Each module has ``main(argv) -> int``, imports no more than it needs and leaves the work to others."""

import os

# Jobs are threads of this package. Those that BLAS adds beside them spin for want of work and take their cores away.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
