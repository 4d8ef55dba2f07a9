"""What a policy does on an arm, as one call."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from rich.console import Console

from benchmark.artifacts.known_policies import policy_folder
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.missing_episodes import play_and_store
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig

if TYPE_CHECKING:
    from benchmark.rollouts.rollout import Rollout


def evaluate(
    policy: str | Path,
    robot: str | RobotConfig,
    method: str = "direct",
    scale: float = 0.0,
    episodes: int = 50,
    *,
    output_dir: str | Path = "results",
    **settings: Any,
) -> pd.DataFrame:
    """Roll a policy out on an arm; what is stored already is not run again.

    Args:
        policy: Name of a policy that ships, such as `seed42-1`, or the folder of a LeRobot checkpoint, or its name on
            the Hub.
        robot: Name of an arm, or `RobotConfig("custom", path=..., base=..., end_effector=...)`.
        method: Guidance, one of `policies.methods.METHODS` or `BY_TASK`.
        scale: Its scale; 0 is direct transfer.
        episodes: How many scenes, from the first validation scene on unless `seed_start` says otherwise.
        output_dir: Folder whose table the rows are stored in.
        settings: Further settings of `benchmark.run` by name, such as `setting="original"` or `workers=4`.

    Returns:
        One row per episode (`docs/data.md` says what the columns are).

    Raises:
        SettingError: If a setting has a value that it cannot have, or a piece is missing.
    """
    folder = policy_folder(str(policy), settings.get("task", RunConfig.task))
    config = RunConfig(
        robot=RobotConfig(robot) if isinstance(robot, str) else robot,
        method="paper" if method == "direct" else method,
        guidance_scale=0.0 if method == "direct" else scale,
        episodes=episodes,
        policy=str(folder),
        output_dir=str(output_dir),
        **settings,
    )
    (config,), console = config.parts, Console(stderr=True)
    rollout: Rollout = make_rollout(config, config.guidance_scale or 0.0, folder, console)
    (rows,) = play_and_store([rollout], config, console)
    return rows
