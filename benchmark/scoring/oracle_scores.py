"""What the scripted oracles reach on an arm: the reference (plain) and the ceiling (aware) of its policies."""

import pandas as pd

from benchmark.episodes.arm import ARM
from benchmark.scoring.ranking import PROTOCOLS
from benchmark.scoring.statistics import rate_interval
from benchmark.settings.config import ORACLE_METHODS
from benchmark.settings.scenes import FIRST_TEST_SEED
from envs.task import Task

ROLES = {"reference": "plain", "ceiling": "aware"}

SEEDS = range(FIRST_TEST_SEED, FIRST_TEST_SEED + max(protocol.episodes for protocol in PROTOCOLS))
"""Episodes of the oracles that count, whatever else was played."""

KEY = [*ARM, "episode_version"]
"""Columns in which an oracle's episodes agree with the policies' that they stand beside."""


def with_oracles(table: pd.DataFrame, episodes: pd.DataFrame, task: Task) -> pd.DataFrame:
    """A leaderboard with the columns `reference` and `ceiling`: n, first seed and scores, or None if not played.

    Args:
        table: The leaderboard.
        episodes: Rows of all methods. An oracle's arm must be the policy's in all columns that describe it, and the
            episode version must be the same. Those of `SEEDS` count.
        task: What they are of.
    """
    if episodes.empty:
        return table.assign(**dict.fromkeys(ROLES))
    episodes = episodes[episodes.episode_seed.isin(SEEDS)]
    arms = [tuple(arm) for arm in table[KEY].itertuples(index=False)]
    for role, oracle in ROLES.items():
        played = _by_arm(episodes[episodes.method == ORACLE_METHODS[oracle]], task)
        table = table.assign(**{role: [played.get(arm) for arm in arms]})
    return table


def _by_arm(played: pd.DataFrame, task: Task) -> dict[tuple, dict[str, float]]:
    """n, first seed and scores with Wilson intervals of an oracle on each arm."""
    scores: dict[tuple, dict[str, float]] = {}
    for key, rows in played.groupby(KEY):
        scores[key] = {"n": len(rows), "first": int(rows.episode_seed.min())}
        for name in task.score_names:
            values = rows[name].to_numpy(dtype=float)
            low, high = rate_interval(values)
            scores[key] |= {name: float(values.mean()), f"{name}_low": low, f"{name}_high": high}
    return scores
