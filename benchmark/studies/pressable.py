"""Do maps tell which buttons an arm can press? What they say, at the press and all along the way to it, against the
arm's kinematic twin.

python -m benchmark.studies.pressable
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import check_choice, check_counts, check_setting
from benchmark.settings.suite import suite_conditions, suites

if TYPE_CHECKING:
    import numpy as np

    from envs.arm.placed_arm import PlacedArm
    from richmap.maps.reachability_map import ReachabilityMap

FIELDS = ("energy", "witness", "coverage", "branch_coverage")
"""What is asked at the flange of each press: the paper's energy and the witness, of which less is better, and the
coverage by the arm's map and by that of its branch."""
ASKED = 16
"""Poses that the map of the branch is asked about each one on the way, as `way_through_map` does it."""
RESAMPLED = 2000


@dataclass
class PressableConfig:
    """Draws buttons, asks the twin which of them the arm presses from its start, and fields how likely that is."""

    suite: str = "all-v1"
    """Whose conditions of pressing buttons without obstacles are looked at."""
    scenes: int = 80
    """Validation scenes, of four buttons each; a whole number >= 10."""
    output: str = "results/pressable.csv"
    """Table that is written."""
    workers: int = 2
    """Processes that sample, where maps are to be built; a whole number >= 1."""

    def __post_init__(self) -> None:
        check_choice("suite", self.suite, suites())
        check_setting(self.scenes >= 10, "scenes", self.scenes, "a whole number >= 10")
        check_scenes(VALIDATION.start, self.scenes)
        check_counts(self, "workers")
        check_file(self.output)


def main(config: PressableConfig) -> None:
    """Print and store, by condition and field, how often a button that is pressed looks better than one that is not."""
    import numpy as np
    import pandas as pd

    from benchmark.artifacts.fields import guidance_field
    from benchmark.episodes.arm import suite_arms
    from richmap.outputs import replacing
    from richmap.progress import plain_console

    console, rows = plain_console(), []
    conditions = {
        name: each
        for name, each in suite_conditions(config.suite).items()
        if each.task == "press_buttons" and not each.arm.obstacles
    }
    for name, arm in suite_arms(conditions).items():
        points, directions, pressed, led_to = presses(arm, config.scenes)
        touching = 100 * led_to[~pressed].mean() if not pressed.all() else np.nan
        row = {"condition": name, "buttons": pressed.size, "pressed": round(100 * pressed.mean(), 1)}
        row["touching, of those not pressed"] = round(touching, 1)
        for kind in FIELDS:
            field, _ = guidance_field(kind, arm, MapConfig(), EnergyConfig(), config.workers, console)
            row[kind] = said(promise(field, points, directions).reshape(pressed.shape), pressed)
        in_branch, _ = guidance_field("branch_map", arm, MapConfig(), EnergyConfig(), config.workers, console)
        row["branch, along the way"] = said(along_the_way(arm, in_branch, config.scenes), pressed)
        rows.append(row)
    table = pd.DataFrame(rows)
    with replacing(Path(config.output)) as path:
        table.to_csv(path, index=False)
    console.print(table.to_markdown(index=False), soft_wrap=True)


def presses(arm: "PlacedArm", scenes: int) -> "tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]":
    """Flange positions, in [m], and approach directions of presses, a row each; whether the arm's twin presses each
    button from its start without touching anything else, and whether it does if touching is overlooked, (scenes,
    buttons) each."""
    import numpy as np

    from envs.press_buttons.scene import draw_scene
    from envs.press_buttons.twin import KinematicTwin
    from envs.press_buttons.workspace import TRAVEL
    from richmap.task_spaces.press_buttons import ROD

    twin, points, directions, pressed, led_to = KinematicTwin(arm), [], [], [], []
    for seed in VALIDATION[:scenes]:
        scene = draw_scene(seed)
        paths = [twin.path(scene.places, scene.normals, i, i) for i in range(len(scene.places))]
        led_to.append([path is not None for path in paths])
        free = (
            path is not None and not twin.touches(scene.places, scene.normals, path, (i,))
            for i, path in enumerate(paths)
        )
        pressed.append([*free])
        points.append(scene.places + (ROD - TRAVEL) * scene.normals)
        directions.append(-scene.normals)
    return np.concatenate(points), np.concatenate(directions), np.array(pressed), np.array(led_to)


def promise(field: object, points: "np.ndarray", directions: "np.ndarray") -> "np.ndarray":
    """How well a field speaks of poses; more is better."""
    from policies.directional_methods import PoseCost
    from richmap.similarity.energy import EnergyField

    if isinstance(field, EnergyField):
        return -field.value_and_gradient(points)[0]
    return -PoseCost(field).value_and_gradients(points, directions).value


def along_the_way(arm: "PlacedArm", in_branch: "ReachabilityMap", scenes: int) -> "np.ndarray":
    """Of the poses about the worst one on the expert's way from the start to each button the share that an arm can hold
    by its map, touching nothing else, (scenes, buttons)."""
    import numpy as np

    from envs.press_buttons.model import PressModel
    from envs.press_buttons.scene import draw_scene
    from richmap.task_spaces.way import Way

    model, found = PressModel(arm).by_map(in_branch), []
    for scene in map(draw_scene, VALIDATION[:scenes]):
        _, environment = model.opening(scene)
        shown, at = np.zeros(len(environment), dtype=bool), zip(scene.places, -scene.normals, strict=True)
        ways = [Way((i,), False, shown, *(each[None] for each in pose)) for i, pose in enumerate(at)]
        found.append([model.share(model.start(), environment, way, ASKED) for way in ways])
    return np.array(found)


def said(seems: "np.ndarray", pressed: "np.ndarray") -> str:
    """`better`, as the table has it; a dash where all buttons are pressed or none is, as no two can be compared."""
    return "{1:.2f} [{0:.2f}, {2:.2f}]".format(*better(seems, pressed)) if 0 < pressed.mean() < 1 else "-"


def better(seems: "np.ndarray", pressed: "np.ndarray") -> tuple[float, float, float]:
    """Probability that one that is pressed seems better than one that is not (the area under the ROC curve): its lower
    bound, itself and its upper bound, of 95 %, for other scenes. Some are pressed and some are not; drawings of scenes
    in which that does not hold are left out."""
    import numpy as np
    from scipy.stats import mannwhitneyu

    rng, found = np.random.default_rng(0), []
    for drawn in (np.arange(len(seems)), *rng.integers(0, len(seems), (RESAMPLED, len(seems)))):
        yes, no = seems[drawn][pressed[drawn]], seems[drawn][~pressed[drawn]]
        if len(yes) and len(no):
            found.append(mannwhitneyu(yes, no, method="asymptotic").statistic / (len(yes) * len(no)))
    low, high = np.quantile(found[1:], [0.025, 0.975])
    return float(low), float(found[0]), float(high)


if __name__ == "__main__":
    run_command(main, PressableConfig, "studies.pressable")
