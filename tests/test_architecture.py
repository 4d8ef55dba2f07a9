import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_imports_run_one_way():
    """In a process of its own, since the linter turns off the loggers that are there, Hydra's too."""
    lint = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", lint], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_only_benchmark_knows_results():
    for package in ("envs", "policies", "richmap"):
        for file in (ROOT / package).rglob("*.py"):
            assert '"results' not in file.read_text(), file


def test_array_shapes_are_checked_while_testing():
    import numpy as np

    from richmap.similarity.similarity import mmd_squared

    with pytest.raises(Exception, match="n 3"):
        mmd_squared(np.ones((4, 2)), np.ones((4, 3)))
