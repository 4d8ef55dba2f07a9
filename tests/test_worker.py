"""Worker processes, started from wherever."""

import pytest
from joblib import Parallel, delayed

pytestmark = pytest.mark.system


def test_a_job_of_a_sweep_has_workers_of_its_own():
    """Such jobs are processes of joblib's; one that lacks a map builds it."""

    def asked_of_workers(numbers):
        from richmap.worker import worker_pool

        with worker_pool(1) as pool:
            return [*pool.map(abs, numbers)]

    assert Parallel(n_jobs=2)([delayed(asked_of_workers)([-1, -2])]) == [[1, 2]]
