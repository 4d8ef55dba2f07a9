"""How worker processes start and end."""

import multiprocessing
import os
import signal
import threading


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
    multiprocessing.parent_process().join()
    os._exit(1)
