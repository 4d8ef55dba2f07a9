"""What a policy does on an arm, as one call."""

from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from benchmark.artifacts.known_policies import policy_folder
from benchmark.rollouts.chosen_players import chosen_players
from benchmark.rollouts.missing_episodes import play_and_store
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.typed import literal, typed
from richmap.progress import plain_console


def evaluate(
    policy: str | Path,
    robot: str | RobotConfig,
    method: str = "direct",
    scale: float | None = None,
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
        method: Guidance, or whatever else `benchmark.run` takes as `method`.
        scale: Its scale; 0 is direct transfer, and None the one that was chosen for it.
        episodes: How many scenes, from the first validation scene on unless `seed_start` says otherwise.
        output_dir: Folder whose table the rows are stored in.
        settings: Further settings of `benchmark.run` by name, such as `setting="original"` or `workers=4`.

    Returns:
        One row per episode (`docs/data.md` says what the columns are).

    Raises:
        SettingError: If a setting has a value that it cannot have, or a piece is missing.
    """
    folder = policy_folder(str(policy), settings.get("task", RunConfig.task))
    given = {
        "robot": robot,
        "method": method,
        "lambda": scale,
        "episodes": episodes,
        "policy": str(folder),
        "output_dir": str(output_dir),
    }
    config = typed(OmegaConf.create({key: literal(value) for key, value in (given | settings).items()}), RunConfig)
    (config,), console = config.parts, plain_console(stderr=True)
    *_, player = chosen_players(config, console)  # Direct transfer comes before.
    (rows,) = play_and_store([player], config, console)
    return rows.reset_index(drop=True)
