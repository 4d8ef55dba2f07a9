"""Worker processes, started from wherever."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from joblib import Parallel, delayed

PATHS = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}

pytestmark = pytest.mark.system


def test_a_job_of_a_sweep_has_workers_of_its_own():
    """Such jobs are processes of joblib's; one that lacks a map builds it."""

    def asked_of_workers(numbers):
        from richmap.worker import worker_pool

        with worker_pool(1) as pool:
            return [*pool.map(abs, numbers)]

    assert Parallel(n_jobs=2)([delayed(asked_of_workers)([-1, -2])]) == [[1, 2]]


def test_a_script_needs_no_guard_against_its_own_workers(tmp_path):
    """They do not run it again, and nothing waits for what it holds."""
    script = tmp_path / "script.py"
    script.write_text(
        "from richmap.worker import worker_pool\n"
        "print('once', flush=True)\n"
        "with worker_pool(2) as pool:\n"
        "    print([*pool.map(abs, [-1, -2])])\n"
    )
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, env=PATHS)
    assert (ended.returncode, ended.stdout) == (0, "once\n[1, 2]\n"), ended.stderr
