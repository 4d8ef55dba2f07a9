"""What is known of an arm before it acts: how much of the source's paths it can follow, and how alike both reach."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from rich.console import Console

from benchmark.settings.map_config import EnergyConfig, MapConfig

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm

PREDICTORS = {
    "tracked": "share of the steps that the arm cannot follow as a path",
    "static": "share of the poses that it cannot reach by themselves",
    "mmd": "MMD of approach directions along the path, where both arms fill the cell",
    "energy": "energy field along the path",
}
"""What each is; more of it should mean less success."""


TOOL_DOWN = (0.0, 1.0, 0.0, 0.0)
"""Of the flange in the world, qx, qy, qz, qw."""


def predictors(
    arm: "PlacedArm",
    paths: Sequence[Float[np.ndarray, "_ 3"]],
    maps: tuple[MapConfig, EnergyConfig] | None,
    workers: int,
    console: Console,
) -> dict[str, float]:
    """The predictors of an arm as it stands.

    Args:
        arm: The arm.
        paths: Flange positions of the source's demonstrations, in [m] in the world.
        maps: Of which maps and field similarity is taken; None leaves that out.
        workers: Processes that sample where a map is to be built.
        console: Where progress is shown.
    """
    import richmap

    robot, base = arm.as_mapped()
    whole = np.concatenate(paths)
    poses = np.column_stack([whole - np.array(base), np.tile(TOOL_DOWN, (len(whole), 1))])
    episodes = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
    checked = richmap.check(robot, poses, episodes)
    found = {"tracked": 1 - checked.steps_followed, "static": 1 - float(checked.reachable.mean())}
    return found if maps is None else found | _similarity(arm, whole, maps, workers, console)


def _similarity(
    arm: "PlacedArm",
    points: Float[np.ndarray, "n 3"],
    maps: tuple[MapConfig, EnergyConfig],
    workers: int,
    console: Console,
) -> dict[str, float]:
    """Mean MMD and energy along positions of the flange, in [m] in the world."""
    from benchmark.artifacts.maps import arm_energy_field, arm_maps
    from richmap.similarity.similarity import compare_maps

    of_map, of_energy = maps
    similar = compare_maps(*arm_maps(arm, of_map, workers, console), arm.as_mapped()[1])
    cells = similar.grid.cells_of(points)
    mmd = np.where(cells >= 0, similar.mmd.reshape(-1)[cells], np.nan)
    field, _ = arm_energy_field(arm, of_map, of_energy, workers, console)
    energy, _ = field.value_and_gradient(points)
    return {"mmd": float(np.nanmean(mmd)) if np.isfinite(mmd).any() else np.nan, "energy": float(np.mean(energy))}
