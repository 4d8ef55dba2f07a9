"""Demonstrations: the scripted oracle on the source arm, stored as a LeRobotDataset.

    python -m benchmark.collect

The oracle's action is always the label. In the disturbed kinds another action is executed now and then
(DART, Laskey et al., CoRL 2017), so that the data show how to come back from mistakes. They are not the
published data.
"""

import hashlib
import json
import os
import shutil
import threading
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import SettingError, check_setting, run_command

if TYPE_CHECKING:
    from benchmark.demonstration import Demonstration

EPISODES_PER_CHUNK = 5
"""Episodes that are stored at once: what a killed worker loses."""


@dataclass
class CollectConfig:
    """Which demonstrations the oracle gives; with all shares 0 clean ones alone, like the published data."""

    episodes: int = 1000
    """Number of demonstrations; the disturbed ones are all successful, the clean ones as they come."""
    seed_start: int = 0
    """Seed of the first episode's scene; seeds 0 to 999 are for demonstrations."""
    share_noise: float = 0.25
    """Share of episodes with Gaussian noise on the executed action now and then."""
    share_bursts: float = 0.4
    """Share of episodes with that noise, and bursts of a few steps in a wrong direction."""
    share_wide: float = 0.25
    """Share of episodes like the last kind that also start from scenes all over the table."""
    output_dir: str = "demonstrations/robust"
    """Folder of the dataset."""
    workers: int = 2
    """Processes that simulate; the data do not depend on it."""

    def __post_init__(self) -> None:
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        shares = ("share_noise", "share_bursts", "share_wide")
        for name in shares:
            check_setting(0 <= getattr(self, name) <= 1, name, getattr(self, name), "a number from 0 to 1")
        total = sum(getattr(self, name) for name in shares)
        check_setting(total <= 1 + 1e-9, " + ".join(shares), total, "a sum of 1 at most; the rest is clean")

    @property
    def recipe(self) -> dict[str, object]:
        """What decides the data: everything but where they are stored and how many processes work."""
        return {key: value for key, value in asdict(self).items() if key not in ("output_dir", "workers")}


def collect(config: CollectConfig) -> Path:
    """Collects the demonstrations if they are not there yet, and gives their folder.

    A run that was killed goes on with the chunks of episodes that it had stored, by the same code.
    """
    from benchmark.rollout import code_version

    root = Path(config.output_dir)
    if root.exists():
        _check_recipe(root, config)
        return root
    about = {"recipe": config.recipe, "code": code_version()}
    chunks = root.parent / f".{root.name}-{digest(about)}"
    chunks.mkdir(parents=True, exist_ok=True)
    _simulate(config, chunks)
    _assemble(config, chunks, root, about)
    shutil.rmtree(chunks)
    return root


def digest(values: Mapping[str, object]) -> str:
    """Short name for settings: the same for equal ones, another for others."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]


def _check_recipe(root: Path, config: CollectConfig) -> None:
    recipe = json.loads((root / "meta" / "collect.json").read_text())["recipe"]
    different = {key: recipe.get(key) for key, value in config.recipe.items() if recipe.get(key) != value}
    if different:
        raise SettingError(
            f"{root} holds demonstrations made otherwise ({different}). Delete the folder or choose another output_dir."
        )


def _simulate(config: CollectConfig, chunks: Path) -> None:
    """Fills the folder with one file per chunk of episodes."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    from benchmark.progress import progress_bar

    missing = [chunk for chunk in _chunks(config) if not _chunk_path(chunks, chunk).exists()]
    done = config.episodes - sum(len(chunk) for chunk in missing)
    with (
        progress_bar() as progress,
        ProcessPoolExecutor(
            min(config.workers, len(missing) or 1), multiprocessing.get_context("spawn"), _die_with_parent
        ) as pool,
    ):
        task = progress.add_task("Demonstrations", total=config.episodes, completed=done)
        futures = {pool.submit(_simulate_chunk, config, chunk, chunks): len(chunk) for chunk in missing}
        try:
            for future in as_completed(futures):
                future.result()
                progress.advance(task, futures[future])
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Otherwise an error or Ctrl-C would wait for all the chunks.
            raise


def _simulate_chunk(config: CollectConfig, seeds: range, chunks: Path) -> None:
    """Worker: one chunk of episodes, stored in one atomic step."""
    import numpy as np

    from benchmark.demonstration import demonstrate, pack, source_env

    env = source_env()
    episodes = [demonstrate(env, seed, _kind(config, seed)) for seed in seeds]
    path = _chunk_path(chunks, seeds)
    partial = path.with_suffix(f".{os.getpid()}.tmp")
    with open(partial, "wb") as file:
        np.savez(file, **pack(episodes))
    os.replace(partial, path)


def _kind(config: CollectConfig, seed: int) -> str:
    """Kind of an episode: drawn by its seed alone, so that more episodes never change the first ones."""
    import numpy as np

    draw = np.random.default_rng((seed, 0)).random()
    shares = {"noise": config.share_noise, "bursts": config.share_bursts, "wide": config.share_wide}
    for kind, share in shares.items():
        if draw < share:
            return kind
        draw -= share
    return "clean"


def _assemble(config: CollectConfig, chunks: Path, root: Path, about: Mapping[str, object]) -> None:
    """Writes the chunks as a LeRobotDataset, which appears under its name when it is complete."""
    from benchmark.demonstration_dataset import write_dataset

    partial = root.with_name(f".{root.name}.{os.getpid()}.tmp")
    write_dataset(_stored(config, chunks), partial, config.episodes)
    about = {**about, "played": _played(config, chunks)}
    (partial / "meta" / "collect.json").write_text(json.dumps(about, indent=2) + "\n")
    os.replace(partial, root)


def _played(config: CollectConfig, chunks: Path) -> dict[str, dict[str, int]]:
    """Episodes kept and episodes played of each kind: failures are played again, disturbed otherwise."""
    counts: dict[str, dict[str, int]] = {}
    for episode in _stored(config, chunks):
        count = counts.setdefault(episode.kind, {"kept": 0, "played": 0})
        count["kept"] += 1
        count["played"] += episode.attempts
    return counts


def _stored(config: CollectConfig, chunks: Path) -> Iterator["Demonstration"]:
    import numpy as np

    from benchmark.demonstration import unpack

    for chunk in _chunks(config):
        with np.load(_chunk_path(chunks, chunk)) as arrays:
            yield from unpack(arrays)


def _chunks(config: CollectConfig) -> list[range]:
    end = config.seed_start + config.episodes
    return [
        range(start, min(start + EPISODES_PER_CHUNK, end))
        for start in range(config.seed_start, end, EPISODES_PER_CHUNK)
    ]


def _chunk_path(chunks: Path, seeds: range) -> Path:
    return chunks / f"{seeds.start:06d}-{seeds.stop:06d}.npz"


def _die_with_parent() -> None:
    """Ends a worker when its parent is gone, however that ended: an orphan would wait for work forever."""
    import multiprocessing

    def watch() -> None:
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main(config: CollectConfig) -> None:
    """Collect, and say where the data are."""
    print(f"Demonstrations: {collect(config)}")


if __name__ == "__main__":
    run_command(main, CollectConfig, "collect")
