"""Capability maps from the cache, built on first use: the paper's counterpart with full orientations per cell.

python -m benchmark.map_quality.capability_map robot=panda
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import check_counts, check_setting

if TYPE_CHECKING:
    from rich.console import Console

    from richmap.counterparts.capability_construction import CapabilityProgress
    from richmap.counterparts.capability_map import CapabilityMap
    from richmap.robots.robot import RobotDescription

VERSION = 1
"""Of these maps: raised by hand when the same robot and settings give another one."""

PAPER_INSERTED = {"panda": 10_700_000, "iiwa7": 9_800_000, "ur5e": 16_400_000, "gen3": 9_100_000}
"""Orientations in the paper's capability maps (RichMap, Table 1), at cells of 0.05 m and theta = 0.4 rad."""


@dataclass
class CapabilityMapConfig:
    """Builds an arm's capability map, which holds full orientations; it is cached."""

    robot: RobotConfig = robot_field("panda")
    """Arm: one that ships, or custom."""
    cell_size: float = 0.05
    """Edge of a cubic cell, in m, above 0."""
    theta: float = 0.4
    """Least angle between two orientations of a cell, in rad, above 0."""
    half_width: float = 1.0
    """The grid spans this far from the base along x and y, and up and down, in m, above 0."""
    z_offset: float = 0.2
    """How much the grid is raised against the base, in m."""
    stop_rate: float = 0.005
    """Building stops when a draw brings less than this fraction of new orientations; between 0 and 1."""
    target: int | None = None
    """Building also stops at so many orientations; 0 for no such target, null for the paper's count where it has one
    (panda, iiwa7, ur5e, gen3)."""
    draw: int = 8192
    """Configurations that a worker draws at once; 1 or more."""
    turns: int = 64
    """Angles of joint 1 that each configuration is used at (orbit sampling); a power of two, 1 for plain sampling."""
    seed: int = 0
    """Seed of the samples; a whole number >= 0."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""

    def __post_init__(self) -> None:
        half_width = self.half_width
        check_setting(0 < half_width <= 10, "half_width", half_width, "a number above 0 and at most 10")
        check_setting(0 < self.cell_size <= half_width / 4, "cell_size", self.cell_size, "up to half_width / 4")
        check_setting(0.1 <= self.theta <= 3, "theta", self.theta, "a number from 0.1 to 3")
        check_setting(abs(self.z_offset) <= 10, "z_offset", self.z_offset, "a number from -10 to 10")
        check_setting(0 < self.stop_rate < 1, "stop_rate", self.stop_rate, "a number between 0 and 1")
        check_setting((self.target or 0) >= 0, "target", self.target, "a whole number >= 0, null")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_counts(self, "draw", "turns", "workers")
        check_setting(self.turns.bit_count() == 1, "turns", self.turns, "a power of two")


def main(config: CapabilityMapConfig) -> None:
    """Build what is missing and say where it is."""
    from richmap.progress import plain_console

    capability_map(config.robot.load(), config, plain_console())


def capability_map(
    description: "RobotDescription", config: CapabilityMapConfig, console: "Console"
) -> tuple["CapabilityMap", Path]:
    """The capability map of a robot, built if it is not in the cache, and its file; the time is kept beside it."""
    import platformdirs

    from richmap.cache import cached, fingerprint
    from richmap.counterparts import capability_construction, capability_map
    from richmap.geometry import grid

    name = description.name
    target = PAPER_INSERTED.get(name, 0) if config.target is None else config.target
    cells = grid.Grid.around_base(config.cell_size, config.half_width, config.z_offset)
    settings = config.theta, config.seed, config.draw, config.turns, config.stop_rate, target
    asked = capability_map.CapabilityConstruction(name, description.fingerprint, *settings)
    key = fingerprint({"grid": asdict(cells), "construction": asdict(asked)}, VERSION)
    file = f"capability_maps/{name}-{key[:16]}.safetensors"
    whole = Path(platformdirs.user_cache_dir("richmap"), file)

    def build() -> capability_map.CapabilityMap:
        with CapabilityBar(name, config.stop_rate, target, console) as bar:
            begin, unfinished = perf_counter(), whole.with_suffix(".unfinished")
            made = capability_construction.build_capability_map(
                description, cells, asked, config.workers, bar.report, unfinished
            )
        whole.with_suffix(".seconds").write_text(f"{perf_counter() - begin:.1f}")
        return made

    built, path = cached(file, lambda path: capability_map.CapabilityMap.load(path, description), build)
    reached = built.construction
    console.print(
        f"Capability map of {name}: {built.inserted / 1e6:.2f} M orientations in {100 * built.occupancy:.1f} % of the "
        f"cells, {built.avg_per_cell:.0f} per cell; {100 * built.insertion_rate:.1f} % of {reached.offered / 1e6:.3g} "
        f"M poses, {100 * reached.batch_rate:.2f} % of the last draw; {built.bytes_memory / 1e6:.0f} MB. {path}",
        soft_wrap=True,
    )
    return built, path


class CapabilityBar:
    """Live state of a build: the insertion rate falls towards its threshold, and the count rises to its target."""

    def __init__(self, robot: str, stop_rate: float, target: int, console: "Console") -> None:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        from richmap.progress import SpokenProgress

        self._stop_rate, self._target = stop_rate, target
        self._progress = SpokenProgress(
            TextColumn(f"Capability map of {robot}"),
            BarColumn(),
            TextColumn("insertion rate {task.fields[rate]:.2%}"),
            TextColumn("{task.fields[millions]:.2f} M orientations, {task.fields[occupancy]:.1%} of cells"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._progress.add_task("", total=1.0, rate=1.0, millions=0.0, occupancy=0.0)

    def __enter__(self) -> "CapabilityBar":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def report(self, progress: "CapabilityProgress") -> None:
        """The insertion rate falls about as 1 / poses, so the share done is stop rate over rate, or that of the count.

        Near the target the count grows ever more slowly: with n of N it takes about (n / N)^2 of the time.
        """
        done = self._stop_rate / max(progress.batch_rate, 1e-9)
        if self._target:
            done = max(done, (progress.inserted / self._target) ** 2)
        self._progress.update(
            self._task,
            completed=min(done, 1.0),
            rate=progress.batch_rate,
            millions=progress.inserted / 1e6,
            occupancy=progress.occupancy,
        )


if __name__ == "__main__":
    run_command(main, CapabilityMapConfig, "capability_map")
