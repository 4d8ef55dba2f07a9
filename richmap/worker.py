"""How worker processes start and end."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any


class _Worker(SpawnProcess):
    """A process that does not run the script again which starts it, as spawned ones do where nothing in the script
    tells them not to."""

    def start(self) -> None:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = script


class _Workers(SpawnContext):
    Process = _Worker


@contextmanager
def worker_pool(
    workers: int, initializer: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that an error, Ctrl-C or SIGTERM in the block ends at once, and that end with this process.

    One that is killed raises `BrokenProcessPool` in the block. What they are given comes from modules, not from the
    script that is run.

    Args:
        workers: How many.
        initializer: Called in each of them first; `start_worker` if None, and otherwise to be called by it.
        arguments: For the initializer.
    """
    if multiprocessing.get_start_method(allow_none=True) == "loky":  # In a process of joblib's.
        multiprocessing.set_start_method("spawn", force=True)  # Its children would look for that method, and lack it.
    others = {child.pid for child in multiprocessing.active_children()}
    with ProcessPoolExecutor(workers, _Workers(), initializer or start_worker, arguments) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                if child.pid not in others:
                    child.kill()
            raise


def start_worker() -> None:
    """Initialise a worker process: one thread of arithmetic, since workers share the cores.

    Ctrl-C ends it without a word, and it ends when its parent is gone, however that ended: an orphan would wait for
    work forever.
    """
    import torch

    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent
    parent.join()
    os._exit(1)
