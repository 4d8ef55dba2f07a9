"""Two tables of episodes, compared on the scenes that both have."""

import pandas as pd

from benchmark.scoring.scores import paired
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task


def compare(episodes: pd.DataFrame, control: pd.DataFrame) -> pd.DataFrame:
    """Paired difference of each score, with a 95 % interval and, where it is yes or no, the exact McNemar p-value.

    Args:
        episodes: Rows of one condition, as `evaluate` gives them.
        control: Rows of the condition that they are compared with, such as direct transfer.

    Returns:
        One row per score: `score`, `n` pairs, `difference`, `low`, `high` and `p`.

    Raises:
        SettingError: If they are of different tasks, or share no scene.
    """
    tasks = {*episodes.get("task", []), *control.get("task", [])}
    if len(tasks) != 1:
        raise SettingError(f"Rows of one task are compared. Got {', '.join(sorted(tasks)) or 'none'}.")
    if not {*episodes.episode_seed} & {*control.episode_seed}:
        raise SettingError("The two tables have no scene in common. Give both the same seed_start.")
    return paired(episodes, control, chosen_task(tasks.pop()))
