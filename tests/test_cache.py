"""The user's cache: what killed builds left in it goes."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock

import richmap
from richmap.cache import WEEK, clear_leftovers
from richmap.outputs import replacing

ROOT = Path(__file__).parents[1]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "richmap"


def test_what_killed_builds_left_is_cleared_after_a_week(cache):
    for name in ("builds/old", "builds/new", "builds/busy"):
        (cache / name).mkdir(parents=True)
        (cache / name / "rows").write_bytes(b"rows")
    killed = replacing(cache / "maps" / "half.safetensors")  # As if its process were, nothing comes after.
    for path in (killed.__enter__(), cache / "maps" / "whole.safetensors"):
        path.write_bytes(b"")
    before = time.time() - WEEK - 60
    for path in cache.rglob("*"):
        if "new" not in path.parts:
            os.utime(path, (before, before))
    with FileLock(cache / "builds" / "busy.lock"):
        clear_leftovers()
        left = {str(path.relative_to(cache)) for path in cache.rglob("*") if path.suffix != ".lock"}
    assert left == {"builds", "maps", "maps/whole.safetensors"} | {
        f"builds/{name}{file}" for name in ("new", "busy") for file in ("", "/rows")
    }


def test_loops_are_compiled_elsewhere_where_the_cache_cannot_be_written_to(tmp_path):
    own = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    env = own | {"XDG_CACHE_HOME": os.devnull, "TMPDIR": str(tmp_path)}
    code = "import os, richmap; print(os.path.isdir(os.environ['NUMBA_CACHE_DIR']), os.environ['NUMBA_CACHE_DIR'])"
    said = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"True {tmp_path}/richmap-") and not [*tmp_path.iterdir()]


def test_loops_are_compiled_anew_where_what_is_compiled_into_them_has_changed(tmp_path):
    for package in ("richmap", "envs"):
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "*.safetensors")
        )

    def state(file, text):
        source = (tmp_path / file).read_text()
        (tmp_path / file).write_text(source + text)
        state = richmap._state_of_loops(tmp_path)
        (tmp_path / file).write_text(source)
        return state

    before = state("richmap/progress.py", "")
    assert state("richmap/progress.py", "# Nothing that a loop knows of.") == before
    of_loops = ["richmap/motion/kinematics.py", "richmap/geometry/grid.py", "envs/press_buttons/workspace.py"]
    assert len({before, *(state(file, "ANGLE = 1.0") for file in of_loops)}) == 4
