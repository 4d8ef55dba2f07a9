"""Two tables of episodes, compared on the scenes that both have."""

from textwrap import shorten

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
        SettingError: If they are no such rows, of different tasks or of several conditions, or share no scene.
    """
    for table in (episodes, control):
        if not isinstance(table, pd.DataFrame) or "episode_seed" not in table:
            shown = f"columns {', '.join(map(str, table))}" if isinstance(table, pd.DataFrame) else repr(table)
            raise SettingError(f"Two tables of rows are compared, as evaluate gives them. Got {shorten(shown, 200)}.")
        if table.episode_seed.duplicated().any():
            raise SettingError("Rows of one condition are compared. A table has a scene more than once.")
    tasks = {*episodes.get("task", []), *control.get("task", [])}
    if len(tasks) != 1:
        raise SettingError(f"Rows of one task are compared. Got {', '.join(sorted(tasks)) or 'none'}.")
    if not {*episodes.episode_seed} & {*control.episode_seed}:
        raise SettingError("The two tables have no scene in common. Give both the same seed_start.")
    return paired(episodes, control, chosen_task(tasks.pop()))
