"""The commands: maps, demonstrations, training, rollouts, tables."""

import os
import platform

if platform.machine() == "x86_64":
    # Before NumPy and PyTorch are loaded: their linear algebra then rounds alike on all processors with AVX2, at a cost
    # of 3 to 5 ms for the 50 actions of a batch.
    os.environ.setdefault("MKL_CBWR", "COMPATIBLE")
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
