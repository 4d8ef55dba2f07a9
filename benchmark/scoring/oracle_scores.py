"""What the scripted oracles reach on an arm: the reference (plain) and the planner (aware)."""

import pandas as pd

from benchmark.episodes.arm import ARM
from benchmark.scoring.ranking import Protocol
from benchmark.scoring.scores import figures
from benchmark.settings.config import ORACLE_METHODS
from envs.task import Task

ROLES = {"reference": "plain", "planner": "aware"}

KEY = [*ARM, "episode_version"]
"""Columns in which an oracle's episodes agree with the policies' that they stand beside."""


def with_oracles(table: pd.DataFrame, episodes: pd.DataFrame, protocol: Protocol, task: Task) -> pd.DataFrame:
    """A leaderboard with the columns `reference` and `planner`: n, first seed and scores, or None if not played.

    Args:
        table: The leaderboard.
        episodes: Rows of all methods. An oracle's arm must be the policy's in all columns that describe it, and the
            episode version must be the same. Those of the protocol's scenes count.
        protocol: Whose scenes count.
        task: What they are of.
    """
    if episodes.empty:
        return table.assign(**dict.fromkeys(ROLES))
    episodes = episodes[episodes.episode_seed.isin(protocol.scenes)]
    arms = [tuple(arm) for arm in table[KEY].itertuples(index=False)]
    for role, oracle in ROLES.items():
        played = _by_arm(episodes[episodes.method == ORACLE_METHODS[oracle]], task)
        table = table.assign(**{role: [played.get(arm) for arm in arms]})
    return table


def _by_arm(played: pd.DataFrame, task: Task) -> dict[tuple, dict[str, float]]:
    """n, first seed and scores with Wilson intervals of an oracle on each arm."""
    scores: dict[tuple, dict[str, float]] = {}
    for key, rows in played.groupby(KEY):
        scores[key] = {"first": int(rows.episode_seed.min())} | figures(rows, task)
        del scores[key]["causes"]
    return scores
