"""Settings under which the numeric libraries add and round alike on different processors.

numpy, OpenBLAS, torch, oneDNN and MKL choose other kernels on another processor, whose sums
and sines differ in the last bits. A process started with these variables keeps to one thread
and, on x86-64, to AVX2.
"""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

AVX2_KERNELS = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Haswell",
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "MKL_CBWR": "AVX2",
}

SETTINGS = {**ONE_THREAD, **(AVX2_KERNELS if platform.machine() == "x86_64" else {})}
"""The variables and their values; libraries read them when they are loaded."""


@contextmanager
def same_arithmetic() -> Iterator[None]:
    """Give processes that are started meanwhile these settings, and no others afterwards."""
    before = {name: os.environ.get(name) for name in SETTINGS}
    os.environ.update(SETTINGS)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
