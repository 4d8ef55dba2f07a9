"""The user's cache: what killed builds left in it goes."""

import os
import time

import pytest
from filelock import FileLock

from richmap.cache import WEEK, clear_leftovers
from richmap.outputs import replacing


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
