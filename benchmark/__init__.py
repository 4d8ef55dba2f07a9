"""The commands: maps, demonstrations, training, rollouts, tables."""

import importlib
import os
import platform
from typing import Any

if platform.machine() == "x86_64":
    # Before NumPy and PyTorch are loaded: their linear algebra then rounds alike on all processors with AVX2, at a cost
    # of 3 to 5 ms for the 50 actions of a batch.
    os.environ.setdefault("MKL_CBWR", "COMPATIBLE")
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

_FACE = {"compare": "benchmark.scoring.comparison", "evaluate": "benchmark.rollouts.evaluation"}
"""What Python callers need, imported when it is asked for."""

__all__ = sorted(_FACE)


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module 'benchmark' has no attribute {name!r}. It has: {', '.join(__all__)}")
    return getattr(importlib.import_module(_FACE[name]), name)


def __dir__() -> list[str]:
    return __all__
