"""Reachability maps, their similarity, and the energy field made from it."""

import hashlib
import os
from pathlib import Path

import platformdirs

# Numba keeps compiled loops by the file that they stand in, and would go on using ones into which the loops of another
# file, changed since, were compiled. So each state of the package has a folder of its own.
_sources = b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.rglob("*.py")))
_folder = Path(platformdirs.user_cache_dir("richmap"), "numba", hashlib.sha256(_sources).hexdigest()[:16])
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
