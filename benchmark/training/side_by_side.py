"""Several trainings side by side, one process each."""

from collections.abc import Sequence
from concurrent.futures import wait
from multiprocessing import get_context
from queue import Empty, Queue

from benchmark.training.collection import collect
from benchmark.training.trainer import TrainConfig, train
from richmap.progress import progress_bar
from richmap.worker import worker_pool

REPORT_EVERY = 10
"""Steps between two movements of the bar."""


def train_all(configs: Sequence[TrainConfig], workers: int) -> None:
    """Trains those policies that are not there yet, their demonstrations first.

    Each training goes on from its last stored state if it was killed; the weights do not depend on `workers`.
    """
    missing = [config for config in configs if not finished(config)]
    if not missing:
        return
    for config in missing:
        collect(config.demonstrations)
    with (
        get_context("spawn").Manager() as manager,
        progress_bar() as progress,
        worker_pool(min(workers, len(missing))) as pool,
    ):
        reports = manager.Queue()
        bar = progress.add_task(f"Training {len(missing)} policies", total=sum(config.steps for config in missing))
        futures = [pool.submit(_train, config, i, reports) for i, config in enumerate(missing)]
        steps = [0] * len(missing)
        while wait(futures, timeout=0).not_done:
            try:
                i, steps[i] = reports.get(timeout=1)
                progress.update(bar, completed=sum(steps))
            except Empty:
                pass
            for future in wait(futures, timeout=0).done:
                future.result()


def finished(config: TrainConfig) -> bool:
    """Whether all of a training's checkpoints are there and nothing is left to do."""
    return not config.states.exists() and all(path.exists() for path in config.checkpoints.values())


def _train(config: TrainConfig, i: int, reports: "Queue[tuple[int, int]]") -> None:
    """Worker: the training of this number; reports its steps."""

    def report(step: int, loss: float) -> None:
        if step % REPORT_EVERY == 0 or step == config.steps:
            reports.put((i, step))

    train(config, report)
