"""Demonstrations on their way to a dataset: files of a few episodes each, made by worker processes."""

from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.training.demonstration import Demonstration, demonstrate, pack, source_env, unpack
from benchmark.training.demonstration_recipe import CollectConfig
from richmap.outputs import replacing
from richmap.progress import progress_bar
from richmap.worker import worker_pool

EPISODES_PER_CHUNK = 5
"""Episodes that are stored at once: what a killed worker loses."""


def simulate(config: CollectConfig, chunks: Path) -> None:
    """Fills the folder with one file per chunk of episodes."""
    missing = [chunk for chunk in _chunks(config) if not _chunk_path(chunks, chunk).exists()]
    done = config.count - sum(len(chunk) for chunk in missing)
    with (
        progress_bar() as progress,
        worker_pool(min(config.workers, len(missing) or 1)) as pool,
    ):
        task = progress.add_task("Demonstrations", total=config.count, completed=done)
        futures = {pool.submit(_simulate_chunk, config, chunk, chunks): len(chunk) for chunk in missing}
        for future in as_completed(futures):
            future.result()
            progress.advance(task, futures[future])


def _simulate_chunk(config: CollectConfig, seeds: range, chunks: Path) -> None:
    """Worker: one chunk of episodes, stored in one atomic step."""
    episodes = [_demonstrate(config, seed) for seed in seeds]
    path = _chunk_path(chunks, seeds)
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, allow_pickle=True, **pack(episodes))


def _demonstrate(config: CollectConfig, seed: int) -> Demonstration:
    """One episode, with its pictures if they are asked for."""
    demonstrator = config.demonstrator
    env = source_env(demonstrator.environment, config.image_size)
    frames: list[tuple[int, Any]] = []

    def watch(attempt: int) -> None:
        if config.image_size:
            frames.append((attempt, env.render()))

    how = (config.burst_probability, config.detours)
    episode = demonstrate(demonstrator, env, seed, kind_of(config, seed), *how, watch)
    pictures = [frame for attempt, frame in frames if attempt == episode.attempts]
    return replace(episode, pictures=np.stack(pictures)) if pictures else episode


def kind_of(config: CollectConfig, seed: int) -> str:
    """Kind of an episode: drawn by its seed alone, so that more episodes never change the first ones."""
    draw = np.random.default_rng((seed, 0)).random()
    for kind, share in config.of_kinds.items():
        if draw < share:
            return kind
        draw -= share
    return "clean"


def played(config: CollectConfig, chunks: Path) -> dict[str, dict[str, int]]:
    """Episodes kept and episodes played of each kind: failures are played again, disturbed otherwise."""
    counts: dict[str, dict[str, int]] = {}
    for episode in stored(config, chunks):
        count = counts.setdefault(episode.kind, {"kept": 0, "played": 0})
        count["kept"] += 1
        count["played"] += episode.attempts
    return counts


def stored(config: CollectConfig, chunks: Path) -> Iterator[Demonstration]:
    """All episodes, in the order of their seeds."""
    for chunk in _chunks(config):
        with np.load(_chunk_path(chunks, chunk)) as arrays:
            yield from unpack(arrays)


def _chunks(config: CollectConfig) -> list[range]:
    end = config.seed_start + config.count
    return [
        range(start, min(start + EPISODES_PER_CHUNK, end))
        for start in range(config.seed_start, end, EPISODES_PER_CHUNK)
    ]


def _chunk_path(chunks: Path, seeds: range) -> Path:
    return chunks / f"{seeds.start:06d}-{seeds.stop:06d}.npz"
