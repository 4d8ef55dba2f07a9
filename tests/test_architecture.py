from pathlib import Path

import pytest
from importlinter.cli import lint_imports

ROOT = Path(__file__).parents[1]


def test_imports_run_one_way():
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_only_benchmark_knows_results():
    for package in ("envs", "policies", "richmap"):
        for file in (ROOT / package).glob("*.py"):
            assert '"results' not in file.read_text(), file


def test_array_shapes_are_checked_while_testing():
    import numpy as np

    from richmap.similarity.similarity import mmd_squared

    with pytest.raises(Exception, match="n 3"):
        mmd_squared(np.ones((4, 2)), np.ones((4, 3)))
