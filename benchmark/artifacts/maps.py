"""Maps."""

import shutil
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from filelock import FileLock
from rich.console import Console

from benchmark.settings.command import SettingError, check_setting
from benchmark.settings.config import SOURCE, EnergyConfig, MapConfig

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm
    from richmap.geometry.grid import Grid
    from richmap.maps.construction import BuildProgress
    from richmap.maps.reachability_map import Construction, ReachabilityMap
    from richmap.robots.robot import RobotDescription
    from richmap.similarity.energy import EnergyField

MAP_VERSION = 1
"""Of maps: raised by hand when the same robot and settings give another one."""
FIELD_VERSION = 1
"""Of energy fields: raised by hand when the same maps and settings give another one."""


def robot_map(
    description: "RobotDescription",
    base: tuple[float, float, float],
    config: MapConfig,
    workers: int,
    console: Console,
) -> "ReachabilityMap":
    """The map of a robot with its base at a point of the world, in [m], built if it is not in the cache."""
    from benchmark.artifacts.cache import cached
    from richmap.geometry import grid
    from richmap.maps import construction, reachability_map

    if config.device == "cuda":
        import torch

        check_setting(torch.cuda.is_available(), "map.device", config.device, "cpu; there is no CUDA device here")
    name = description.name
    cells = grid.Grid.around_base(config.cell_size, config.half_width, config.z_offset).moved(np.array(base))
    asked = construction_of(description, config)
    key, folder = _key_and_folder(cells, asked)
    lock, made = FileLock(f"{folder}.lock"), []

    def build() -> reachability_map.ReachabilityMap:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with lock, MapProgress(name, config, console) as progress:
            try:
                built = construction.build_map(description, cells, asked, folder, workers, progress.report)
            except ValueError as error:
                raise SettingError(f"robot={name}: {error}") from error
        _seconds_file(built).write_text(f"{progress.seconds:.1f}")
        made.append(built)
        return built

    def load(path: Path) -> reachability_map.ReachabilityMap:
        return reachability_map.ReachabilityMap.load(path, description)

    built, path = cached(f"maps/{name}-{key[:16]}.safetensors", load, build)
    if made:  # and stored, so that what the build could go on from is not needed any more
        with lock:
            shutil.rmtree(folder, ignore_errors=True)
    if made:
        console.print(
            f"Reachability map of {name}, built once and kept in {path}: {built.inserted / 1e6:.2f} million directions "
            f"in {100 * built.occupancy:.1f} % of its cells.",
            soft_wrap=True,
        )
    return built


def construction_of(robot: "RobotDescription", config: MapConfig) -> "Construction":
    """A map's construction as these settings ask for it."""
    from richmap.maps.reachability_map import Construction

    names = {each.name for each in fields(Construction)} & {*vars(config)}
    return Construction(robot.name, robot.fingerprint, **{name: getattr(config, name) for name in names})


def _key_and_folder(cells: "Grid", asked: "Construction") -> tuple[str, Path]:
    """Fingerprint of a map, and the folder of its build, which goes on from where one with another end stopped."""
    import platformdirs

    from benchmark.artifacts.cache import fingerprint

    inputs = {"grid": asdict(cells), "construction": asdict(asked)}
    key = fingerprint(inputs, MAP_VERSION)
    for ending in ("stop_rate", "target"):
        del inputs["construction"][ending]
    folder = f"{asked.robot}-{fingerprint(inputs, MAP_VERSION)[:16]}"
    return key, Path(platformdirs.user_cache_dir("richmap"), "builds", folder)


def build_seconds(built: "ReachabilityMap") -> float:
    """Wall time that the build of a map took on this machine, in [s]; NaN where it was not built here."""
    from benchmark.artifacts.cache import seconds

    return seconds(_seconds_file(built))


def _seconds_file(built: "ReachabilityMap") -> Path:
    """Beside the map and not in it: the same settings give the same file."""
    import platformdirs

    return Path(platformdirs.user_cache_dir("richmap"), "maps", f"{built.content_hash[:16]}.seconds")


def compared_maps(
    target: "RobotDescription",
    base: tuple[float, float, float],
    config: MapConfig,
    workers: int,
    console: Console,
) -> tuple["ReachabilityMap", "ReachabilityMap"]:
    """The maps that a field is made of: the source's, and that of a target arm with its base at a point, in [m]."""
    from richmap.robots.robots import load_robot

    source = load_robot(SOURCE)
    source_map = robot_map(source, (0.0, 0.0, 0.0), config, workers, console)
    same = target == source and not any(base)
    return source_map, source_map if same else robot_map(target, base, config, workers, console)


def arm_energy_field(
    arm: "PlacedArm", map_config: MapConfig, config: EnergyConfig, workers: int, console: Console
) -> tuple["EnergyField", Path]:
    """The field of an arm as it stands, against the source."""
    return energy_field(arm.description.turned(arm.yaw), arm.base, map_config, config, workers, console)


def arm_maps(
    arm: "PlacedArm", config: MapConfig, workers: int, console: Console
) -> tuple["ReachabilityMap", "ReachabilityMap"]:
    """The maps of the source and of an arm as it stands."""
    return compared_maps(arm.description.turned(arm.yaw), arm.base, config, workers, console)


def energy_field(
    target: "RobotDescription",
    base: tuple[float, float, float],
    map_config: MapConfig,
    config: EnergyConfig,
    workers: int,
    console: Console,
) -> tuple["EnergyField", Path]:
    """The field of a target arm, with its base at a point of the world, in [m], against the source.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    from benchmark.artifacts.cache import cached, made_from
    from richmap.robots.robots import load_robot
    from richmap.similarity.energy import EnergyField
    from richmap.similarity.energy_settings import EnergySettings
    from richmap.similarity.similarity import similarity

    inputs = {
        "field": "energy",
        "source": load_robot(SOURCE).fingerprint,
        "target": target.fingerprint,
        "base": [x + 0.0 for x in base],  # No negative zero.
        "map": asdict(map_config) | {"version": MAP_VERSION},
        "energy": asdict(config),
    }
    key = made_from(inputs, FIELD_VERSION)
    choices = asdict(config)
    scales = choices.pop("scales")

    def build() -> EnergyField:
        source_map, target_map = compared_maps(target, base, map_config, workers, console)
        with console.status(f"Comparing {SOURCE} and {target.name}"):
            grid = similarity(source_map, target_map, base, scales)
            about = {"source": SOURCE, "target": target.name, "fingerprint": key}
            return EnergyField.from_similarity(grid, EnergySettings(**choices), about)

    return cached(f"fields/{SOURCE}-{target.name}-{key[:16]}.safetensors", EnergyField.load, build)


class MapProgress:
    """Live state of a build: the insertion rate falls towards the threshold, and with it the time left."""

    def __init__(self, robot: str, config: MapConfig, console: Console) -> None:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        from benchmark.artifacts.progress import SpokenProgress

        self.seconds = 0.0
        """What the build took so far, in [s]."""
        self._stop_rate, self._target = config.stop_rate, config.target
        self._progress = SpokenProgress(
            TextColumn("Map of {task.fields[robot]}"),
            BarColumn(),
            TextColumn("insertion rate {task.fields[rate]:.2%} of {task.fields[stop]:.2%}"),
            TextColumn("{task.fields[millions]:.1f} M directions, {task.fields[occupancy]:.1%} of cells"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._progress.add_task(
            "", total=1.0, robot=robot, rate=1.0, stop=config.stop_rate, millions=0.0, occupancy=0.0
        )

    def __enter__(self) -> "MapProgress":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def report(self, progress: "BuildProgress") -> None:
        """The insertion rate falls about as 1 / poses, so the share done is stop rate over rate."""
        self.seconds = progress.seconds
        shares = [self._stop_rate / max(progress.batch_rate, 1e-9)]
        if self._target:
            shares.append(progress.inserted / self._target)
        self._progress.update(
            self._task,
            completed=min(1.0, max(shares)),
            rate=progress.batch_rate,
            millions=progress.inserted / 1e6,
            occupancy=progress.occupancy,
        )
