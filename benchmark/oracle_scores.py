"""What the scripted oracles reach on an arm: the reference (plain) and the ceiling (aware) of its policies."""

import json
from pathlib import Path

import pandas as pd

from benchmark.config import FIRST_TEST_SEED
from benchmark.ranking import ARM
from benchmark.scores import SCORES
from benchmark.statistics import rate_interval

ROLES = {"reference": "plain", "ceiling": "aware"}


def with_oracles(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """A leaderboard with the columns `reference` and `ceiling`: n, first seed and scores, or None if not measured.

    The oracle's arm must be the policy's in all columns that describe it. Of several measurements the one on the test
    episodes counts, and of those the one of most.
    """
    measured = sorted(oracle_scores(folder), key=lambda x: (x["first"] != FIRST_TEST_SEED, -x["n"]))
    return table.assign(
        **{
            role: [
                next(
                    (x for x in measured if x["oracle"] == oracle and all(x[k] == row[k] for k in ARM)),
                    None,
                )
                for row in table.to_dict("records")
            ]
            for role, oracle in ROLES.items()
        }
    )


def oracle_scores(folder: Path) -> list[dict]:
    """Scores with their intervals of all oracles on all arms: by `benchmark.arms`, then by `benchmark.oracle`."""
    scores = []
    for file in sorted(folder.glob("arms/*.parquet")):
        for arm, rows in pd.read_parquet(file).groupby([*ARM, "oracle"]):
            about = dict(zip([*ARM, "oracle"], arm, strict=True)) | {"n": len(rows), "first": rows.episode_seed.min()}
            scores.append(about | {name: float(rows[name].mean()) for name in SCORES})
    for file in sorted(folder.glob("oracle/*/oracle.json")):
        found = json.loads(file.read_text())
        about = found | {"score": found["mean_score"], "first": found["seed_start"], "branch": found["wrist"]}
        about["base"] = " ".join(f"{x:g}" for x in found["base"])
        scores.append({name: about[name] for name in [*ARM, "oracle", "n", "first", *SCORES]})
    for row in scores:
        for name in SCORES:
            row[f"{name}_low"], row[f"{name}_high"] = rate_interval([row[name]] * row["n"])
    return scores
