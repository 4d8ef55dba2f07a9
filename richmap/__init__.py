"""Reachability maps, their similarity, and the energy field made from it."""

import atexit
import hashlib
import importlib
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import platformdirs

_IMPORTS = re.compile(rb"^(?:from ([\w.]+) )?import (\([^)]*\)|[\w., ]+)", re.MULTILINE)


def _state_of_loops(root: Path) -> str:
    """A hash of the modules that hold compiled loops and of those that they import, from which constants come."""
    found = (file for package in ("richmap", "envs") for file in sorted((root / package).rglob("*.py")))
    sources = {file.relative_to(root).with_suffix("").as_posix().replace("/", "."): file.read_bytes() for file in found}
    reached = {name for name, source in sources.items() if b"@numba.njit" in source}
    wanted = [*reached]
    while wanted:
        for package, names in _IMPORTS.findall(sources[wanted.pop()]):
            each = [name.strip(" ()\n") for name in names.decode().split(",")]
            new = {package.decode(), *each, *(f"{package.decode()}.{name}" for name in each)} & {*sources} - reached
            reached |= new
            wanted += new
    return hashlib.sha256(b"".join(sources[name] for name in sorted(reached))).hexdigest()[:16]


# Numba keeps compiled loops by the file that they stand in, and would go on using ones into which another file, changed
# since, was compiled. So each state of these files has a folder of its own. Numba wants to write to it also where it
# only reads: where it may not, as in a home that is read-only, a copy goes with this process.
_folder = Path(platformdirs.user_cache_dir("richmap"), "numba", _state_of_loops(Path(__file__).parents[1]))
if "NUMBA_CACHE_DIR" not in os.environ:
    with suppress(OSError):
        _folder.mkdir(parents=True, exist_ok=True)
    if not os.access(_folder, os.W_OK):
        _copy = Path(mkdtemp(prefix="richmap-"))
        atexit.register(shutil.rmtree, _copy, ignore_errors=True)
        for _loop in _folder.glob("*/*"):
            (_copy / _loop.parent.name).mkdir(exist_ok=True)
            shutil.copyfile(_loop, _copy / _loop.parent.name / _loop.name)
        _folder = _copy
    os.environ["NUMBA_CACHE_DIR"] = str(_folder)

# What a user needs, imported when it is asked for: the loops are compiled, and PyTorch is read, on the way.
_FACE = {
    "CacheError": "richmap.outputs",
    "DirectionalCoverage": "richmap.similarity.directional",
    "DirectionalDistance": "richmap.similarity.directional",
    "DirectionalEnergy": "richmap.similarity.directional",
    "EnergyField": "richmap.similarity.energy",
    "EnergySettings": "richmap.similarity.energy_settings",
    "ReachabilityMap": "richmap.maps.reachability_map",
    "RobotDescription": "richmap.robots.robot",
    "SignedDistanceField": "richmap.similarity.signed_distance",
    "PathCheck": "richmap.paths.path_check",
    "build_map": "richmap.maps.cached_map",
    "check": "richmap.paths.check",
    "compare_maps": "richmap.similarity.similarity",
    "custom_robot": "richmap.robots.custom",
    "load_robot": "richmap.robots.robots",
}

__all__ = sorted(_FACE)


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module 'richmap' has no attribute {name!r}. It has: {', '.join(__all__)}")
    return getattr(importlib.import_module(_FACE[name]), name)


def __dir__() -> list[str]:
    return __all__
