"""A small network in place of the energy over positions and directions, beside plain ways to make that field smaller.

python -m benchmark.studies.learned_energy robot=ur3
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.robot_config import check_targets
from benchmark.settings.setting import check_counts, check_setting

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.studies.energy_network import Poses
    from richmap.similarity.directional_field import DirectionalField, ValueAndGradients

type Asked = Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], "ValueAndGradients"]
"""A field as it is asked."""

KEY = ["robot", "form"]
MOST_POSES, MOST_WIDTH = 10_000_000, 4096


@dataclass
class LearnedEnergyConfig:
    """Trains networks on the energy in SE(3) of an arm, and says how far they and other compressions are off."""

    robot: str = "ur3"
    """Target arm, its base at the source's."""
    widths: list[int] = field(default_factory=lambda: [64, 128, 256])
    """Widths of the three hidden layers, one network each; whole numbers from 1 to 4096."""
    steps: int = 5_000
    """Steps of training; a whole number >= 1."""
    poses: int = 1_000_000
    """Poses that are learned from; a whole number from 1 to 10 million."""
    asked: int = 50_000
    """Other poses, on which the error is measured; a whole number from 1 to 10 million."""
    seed: int = 0
    """Of poses and networks, a whole number >= 0."""
    output: str = "results/learned_energy.csv"
    """Table that rows go to, in place of older ones of the same arm and form."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets([self.robot])
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_counts(self, "steps", "workers")
        for name in ("poses", "asked"):
            count = getattr(self, name)
            check_setting(1 <= count <= MOST_POSES, name, count, f"a whole number from 1 to {MOST_POSES}")
        widths = all(1 <= width <= MOST_WIDTH for width in self.widths)
        check_setting(widths, "widths", self.widths, f"whole numbers from 1 to {MOST_WIDTH}")
        check_file(self.output)


def main(config: LearnedEnergyConfig) -> None:
    """Measure each form, and store and print the table; maps come from the cache, or are built first."""
    import pandas as pd
    import torch

    from benchmark.artifacts.maps import compared_maps
    from benchmark.artifacts.outputs import store_rows
    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot
    from richmap.similarity.directional import DirectionalEnergy

    torch.set_num_threads(1)
    console, rng = plain_console(), np.random.default_rng(config.seed)
    base = (0.0, 0.0, 0.0)
    source, target = compared_maps(load_robot(config.robot), base, config.map, config.workers, console)
    energy = DirectionalEnergy.from_maps(source, target, base, "coverages")
    asked, learned = (drawn(energy, count, rng) for count in (config.asked, config.poses))
    truth, table = energy.value_and_gradients(*asked), pd.DataFrame()
    drew = {"seed": config.seed, "steps": config.steps, "poses": config.poses}
    for form, size, ask in chain(compressed(energy), networks(energy, learned, config, console)):
        ask(*(each[:1] for each in asked))  # Splines are made and loops compiled here.
        begun = process_time()
        found = ask(*asked)
        spent = round(1e6 * (process_time() - begun) / config.asked, 2)
        row = {
            "robot": config.robot,
            "form": form,
            "kB": round(size / 1000),
            **errors(found, truth),
            "us": spent,
            **drew,
        }
        table = store_rows(Path(config.output), pd.DataFrame([row]), KEY)
    console.print(table.round(1).to_markdown(index=False), soft_wrap=True, highlight=False, markup=False)


def drawn(energy: "DirectionalField", count: int, rng: np.random.Generator) -> "Poses":
    """Poses with uniform directions, their positions uniform in cells where the field is not 0."""
    filled = np.flatnonzero(np.abs(energy.values).max(-1) > 1e-3)
    size, centres = energy.grid.cell_size, energy.grid.centres()
    low, high = centres[0], centres[-1]
    positions = centres[rng.choice(filled, count)] + rng.uniform(-size / 2, size / 2, (count, 3))
    directions = rng.normal(size=(count, 3))
    return positions.clip(low, high), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def errors(found: "ValueAndGradients", truth: "ValueAndGradients") -> dict[str, float]:
    """Root mean square of what is missing, in percent of the truth's own: value, slopes over position, direction."""
    names = ("value off by, %", "slope over position, %", "slope over direction, %")
    return {
        name: round(100 * float(np.sqrt(((one - other) ** 2).mean() / (other**2).mean())), 3)
        for name, one, other in zip(names, found, truth, strict=True)
    }


def compressed(energy: "DirectionalField") -> Iterator[tuple[str, int, Asked]]:
    """The field itself, and smaller ones of its kind: name, bytes, and how it is asked."""
    values = energy.values
    yield "as it is", values.nbytes, energy.value_and_gradients
    for degree in (2, 4, 6):
        lower = replace(energy, values=values[..., : (degree + 1) ** 2].copy())
        yield f"degree {degree}", lower.values.nbytes, lower.value_and_gradients
        half = replace(lower, values=lower.values.astype(np.float16).astype(np.float32))
        yield f"degree {degree}, in 16 bits", lower.values.nbytes // 2, half.value_and_gradients
    flat = values.reshape(-1, values.shape[3])
    _, _, axes = np.linalg.svd(flat.T @ flat)
    for rank in (8, 16):
        kept = flat @ axes[:rank].T
        low = replace(energy, values=(kept @ axes[:rank]).reshape(values.shape))
        yield f"{rank} of {len(axes)} combinations", kept.nbytes + axes[:rank].nbytes, low.value_and_gradients
    coarse = replace(energy, grid=replace(energy.grid, cell_size=2 * energy.grid.cell_size), values=halved(values))
    coarse = replace(coarse, grid=replace(coarse.grid, shape=coarse.values.shape[:3]))
    yield "cells twice as long", coarse.values.nbytes, within(coarse)


def halved(values: Float[np.ndarray, "nx ny nz k"]) -> Float[np.ndarray, "mx my mz k"]:
    """Means of cubes of eight cells; what is left over at the upper end is cut off."""
    nx, ny, nz = (n // 2 for n in values.shape[:3])
    cubes = values[: 2 * nx, : 2 * ny, : 2 * nz].reshape(nx, 2, ny, 2, nz, 2, -1)
    return cubes.mean((1, 3, 5)).astype(np.float32)


def within(energy: "DirectionalField") -> Asked:
    """A field as it is asked, at the nearest place that it knows."""
    low, high = (np.array([axis[end] for axis in energy.grid.axes()]) for end in (0, -1))
    return lambda positions, directions: energy.value_and_gradients(positions.clip(low, high), directions)


def networks(
    energy: "DirectionalField", poses: "Poses", config: LearnedEnergyConfig, console: "Console"
) -> Iterator[tuple[str, int, Asked]]:
    """Networks that were trained on the field's values: name, bytes of the weights, and how each is asked."""
    from benchmark.studies.energy_network import LAYERS, answered, trained
    from richmap.progress import progress_bar

    values = energy.value_and_gradients(*poses).value
    for width in config.widths:
        name = f"network of {LAYERS} x {width}"
        with progress_bar(console) as progress:
            report = partial(progress.advance, progress.add_task(name, total=config.steps))
            network = trained(poses, values, width, config.steps, config.seed, report)
        yield name, sum(4 * weights.numel() for weights in network.parameters()), partial(answered, network)


if __name__ == "__main__":
    run_command(main, LearnedEnergyConfig, "learned_energy")
