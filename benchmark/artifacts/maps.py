"""Maps."""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import SOURCE
from benchmark.settings.setting import SettingError, check_setting
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.robots.robot import RobotDescription
    from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy
    from richmap.similarity.energy import EnergyField
    from richmap.similarity.signed_distance import SignedDistanceField

    type Mapped = tuple[RobotDescription, tuple[float, float, float]]

SHIPPED = Path(__file__).parent / "shipped"
"""Fields of the suites' conditions (`benchmark.studies.shipped_fields`)."""
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
    from richmap.maps.cached_map import build_map

    if description.name not in ROBOTS and (said := _grid_remark(description, base, config)):
        console.print(said, soft_wrap=True)
    if config.device == "cuda":
        import torch

        check_setting(torch.cuda.is_available(), "map.device", config.device, "cpu; there is no CUDA device here")
    try:
        return build_map(description, base=base, workers=workers, console=console, **config.construction)
    except ValueError as error:
        raise SettingError(f"robot={description.name}: {error}") from error


def cached_map(description: "RobotDescription", config: MapConfig) -> "ReachabilityMap | None":
    """The map of a robot in its base frame if it is in the cache."""
    from richmap.maps.cached_map import build_map
    from richmap.outputs import CacheError

    try:
        return build_map(description, only_cached=True, **config.construction)
    except CacheError:
        return None


@cache
def _grid_remark(description: "RobotDescription", base: tuple[float, float, float], config: MapConfig) -> str | None:
    """What the map cuts off or leaves empty, if anything."""
    from richmap.motion.remarks import grid_remark

    return grid_remark(description, config.half_width, (-base[0], -base[1], config.z_offset - base[2]))


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
    return energy_field(*arm.as_mapped(), map_config, config, workers, console)


def arm_maps(
    arm: "PlacedArm", config: MapConfig, workers: int, console: Console
) -> tuple["ReachabilityMap", "ReachabilityMap"]:
    """The maps of the source and of an arm as it stands."""
    return compared_maps(*arm.as_mapped(), config, workers, console)


def arm_map(arm: "PlacedArm", config: MapConfig, workers: int, console: Console) -> tuple["ReachabilityMap"]:
    """The map of an arm as it stands."""
    return (robot_map(*arm.as_mapped(), config, workers, console),)


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
    from richmap.robots.robots import load_robot
    from richmap.similarity.energy import EnergyField
    from richmap.similarity.energy_settings import EnergySettings
    from richmap.similarity.similarity import compare_maps

    choices = asdict(config)
    scales = choices.pop("scales")

    def build() -> EnergyField:
        source_map, target_map = compared_maps(target, base, map_config, workers, console)
        with console.status(f"Comparing {SOURCE} and {target.name}"):
            grid = compare_maps(source_map, target_map, base, scales)
            about = {"source": SOURCE, "target": target.name}
            return EnergyField.from_similarity(grid, EnergySettings(**choices), about)

    more = {"source": load_robot(SOURCE).fingerprint, "energy": asdict(config)}
    return _of_maps("energy", (target, base), map_config, more, EnergyField, build, begins=SOURCE)


def arm_branch_map(arm: "PlacedArm", config: MapConfig, workers: int, console: Console) -> tuple["ReachabilityMap"]:
    """The map of an arm as it stands, in its branch and above the table."""
    return (robot_map(*arm.as_mapped_in_branch(), _above_table(arm, config), workers, console),)


def arm_branch_map_and_file(
    arm: "PlacedArm", config: MapConfig, _energy: EnergyConfig, workers: int, console: Console
) -> tuple["ReachabilityMap", Path]:
    """The same as methods look at it, and its file in the cache."""
    from richmap.maps.cached_map import file_of

    (built,) = arm_branch_map(arm, config, workers, console)
    return built, file_of(built)


def arm_coverage(
    arm: "PlacedArm", map_config: MapConfig, _energy: EnergyConfig, workers: int, console: Console
) -> tuple["DirectionalCoverage", Path]:
    """Which approach directions an arm as it stands reaches where, by its map.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    return _coverage("coverage", arm.as_mapped(), map_config, workers, console)


def arm_branch_coverage(
    arm: "PlacedArm", map_config: MapConfig, _energy: EnergyConfig, workers: int, console: Console
) -> tuple["DirectionalCoverage", Path]:
    """The same by the map of its branch above the table."""
    mapped = arm.as_mapped_in_branch()
    return _coverage("branch_coverage", mapped, _above_table(arm, map_config), workers, console)


def arm_reach(
    arm: "PlacedArm", map_config: MapConfig, config: EnergyConfig, workers: int, console: Console
) -> tuple["SignedDistanceField", Path]:
    """Signed distance to the border of where an arm as it stands can hold its tool upright, by its map.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    from envs.block_push.holding import BOX, CELL_SIZE, COVERED, mapped_distance
    from envs.block_push.workspace import HEIGHT
    from richmap.similarity.signed_distance import SignedDistanceField

    def build() -> SignedDistanceField:
        coverage, _ = arm_coverage(arm, map_config, config, workers, console)
        return mapped_distance(coverage, arm.kinematic_base)

    over = {"box": BOX, "height": HEIGHT, "spacing": CELL_SIZE, "covered": COVERED}
    return _of_maps("reach", arm.as_mapped(), map_config, over, SignedDistanceField, build)


def arm_branch_reach(
    arm: "PlacedArm", map_config: MapConfig, _energy: EnergyConfig, workers: int, console: Console
) -> tuple["SignedDistanceField", Path]:
    """The same by the map of its branch above the table.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    from envs.block_push.holding import ASKED, BOX, CELL_SIZE, LEANING, NEAR, REACHED, branch_distance
    from envs.block_push.workspace import HEIGHT
    from richmap.similarity.signed_distance import SignedDistanceField

    def build() -> SignedDistanceField:
        return branch_distance(*arm_branch_map(arm, map_config, workers, console), arm.kinematic_base)

    over = {"box": BOX, "height": HEIGHT, "spacing": CELL_SIZE, "near": NEAR, "leaning": LEANING}
    over |= {"asked": ASKED, "reached": REACHED}
    of_map = _above_table(arm, map_config)
    return _of_maps("branch_reach", arm.as_mapped_in_branch(), of_map, over, SignedDistanceField, build)


def arm_witness(
    arm: "PlacedArm", map_config: MapConfig, _energy: EnergyConfig, workers: int, console: Console
) -> tuple["DirectionalEnergy", Path]:
    """Which approach directions the source has where and an arm as it stands lacks, by their maps.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    from richmap.robots.robots import load_robot
    from richmap.similarity.directional import DirectionalEnergy

    def build() -> DirectionalEnergy:
        both = arm_maps(arm, map_config, workers, console)
        return DirectionalEnergy.from_maps(*both, arm.as_mapped()[1], "coverages")

    of_source = {"source": load_robot(SOURCE).fingerprint}
    return _of_maps("witness", arm.as_mapped(), map_config, of_source, DirectionalEnergy, build)


def _above_table(arm: "PlacedArm", config: MapConfig) -> MapConfig:
    """Settings of a map above the table on which an arm stands, unless they name a ground."""
    return config if config.ground is not None else replace(config, ground=0.0 - arm.base[2])


def _coverage(
    name: str, mapped: "Mapped", map_config: MapConfig, workers: int, console: Console
) -> tuple["DirectionalCoverage", Path]:
    from richmap.similarity.directional import DirectionalCoverage

    def build() -> DirectionalCoverage:
        return DirectionalCoverage.from_map(robot_map(*mapped, map_config, workers, console), mapped[1])

    return _of_maps(name, mapped, map_config, {}, DirectionalCoverage, build)


def _of_maps[F: ("DirectionalCoverage", "DirectionalEnergy", "EnergyField", "SignedDistanceField")](
    name: str,
    mapped: "Mapped",
    map_config: MapConfig,
    more: dict[str, Any],
    kind: type[F],
    build: Callable[[], F],
    begins: str = "",
) -> tuple[F, Path]:
    """Such a field from the cache, or made now.

    Args:
        more: What else it follows from.
        begins: How its file's name begins, if not with its own.
    """
    from richmap.cache import cached, made_from
    from richmap.maps.cached_map import MAP_VERSION

    target, base = mapped
    inputs = {
        "field": name,
        "target": target.fingerprint,
        "base": [x + 0.0 for x in base],  # No negative zero.
        "map": map_config.construction | {"version": MAP_VERSION},
    }
    key = made_from(inputs | more, FIELD_VERSION)

    def made() -> F:
        field = build()
        return replace(field, about={**field.about, "fingerprint": key})

    shipped = None if map_config.rebuild else SHIPPED
    return cached(f"fields/{begins or name}-{target.name}-{key[:16]}.safetensors", kind.load, made, shipped)
