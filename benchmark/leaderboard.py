"""The leaderboard: a pure function of the episodes table.

python -m benchmark.leaderboard
"""

from pathlib import Path

import pandas as pd

from benchmark.command import SettingError, run_command
from benchmark.config import LeaderboardConfig
from benchmark.outputs import replacing
from benchmark.statistics import paired_difference, paired_p_value, rate_interval

SCORES = ["score", "p1", "p2", "success_at_end"]
"""Columns that are ranked: the original's score, some block in a target, both, both still one second later."""

CONDITION = [
    "robot", "setting", "base", "branch", "orientation_weight", "method", "lambda", "sampler", "sampling_steps",
    "checkpoint", "checkpoint_hash", "field_fingerprint", "cell_size", "batch_shape", "device", "code_version",
]  # fmt: skip
"""What episodes must share to be counted together."""


def leaderboard(episodes: pd.DataFrame) -> pd.DataFrame:
    """One row per condition: n, each score with its 95 % interval, and failed episodes by cause; best p2 first.

    Args:
        episodes: The episodes table (`benchmark.results.Episode.row`).
    """
    rows = []
    for condition, group in episodes.groupby(CONDITION, dropna=False, sort=True):
        row = dict(zip(CONDITION, condition, strict=True)) | {
            "n": len(group),
            "seeds": f"{group.episode_seed.min()}-{group.episode_seed.max()}",
        }
        for score in SCORES:
            values = group[score].to_numpy(dtype=float)
            row[score] = values.mean()
            row[f"{score}_low"], row[f"{score}_high"] = rate_interval(values)
        row["causes"] = group.failure_cause.dropna().value_counts().to_dict()
        rows.append(row)
    return pd.DataFrame(rows).sort_values(["setting", "robot", "p2"], ascending=[True, True, False])


def paired(episodes: pd.DataFrame, control: pd.DataFrame) -> pd.DataFrame:
    """Difference of each score to a control on the episode seeds that both have; p-values by exact McNemar."""
    pairs = episodes.merge(control, on="episode_seed", suffixes=("", "_control"))
    rows = []
    for score in SCORES:
        a, b = pairs[score].to_numpy(dtype=float), pairs[f"{score}_control"].to_numpy(dtype=float)
        difference, low, high = paired_difference(a, b)
        p_value = None if score == "score" else paired_p_value(a, b)
        rows.append(
            {
                "score": score,
                "n": len(pairs),
                "difference": difference,
                "low": low,
                "high": high,
                "p": p_value,
            }
        )
    return pd.DataFrame(rows)


def markdown(table: pd.DataFrame) -> str:
    """The leaderboard as a document."""
    shown = pd.DataFrame(
        {
            "setting": table["setting"],
            "robot": table["robot"],
            "method": table["method"],
            "λ": table["lambda"].map("{:g}".format),
            "checkpoint": table["checkpoint"],
            "sampler": table["sampler"] + "-" + table["sampling_steps"].astype(str),
            "n": table["n"],
            "episode seeds": table["seeds"],
            **{name: [with_interval(row, name) for _, row in table.iterrows()] for name in SCORES},
            "failed episodes by cause": table["causes"].map(causes_text),
            "code": table["code_version"],
        }
    )
    return "\n".join(
        [
            "# Leaderboard",
            "",
            "Made from `episodes.parquet` alone by `python -m benchmark.leaderboard`. Score: 0.49 for some block in a",
            "target, 1 for both; p1: some block in a target; p2: both in different targets at one moment;",
            "success_at_end: both still there one second later. Brackets: 95 % intervals over episodes (Wilson).",
            "",
            shown.to_markdown(index=False),
            "",
        ]
    )


def with_interval(row: pd.Series, name: str) -> str:
    """A score and its interval, in percent."""
    return f"{100 * row[name]:.1f} [{100 * row[f'{name}_low']:.1f}, {100 * row[f'{name}_high']:.1f}]"


def causes_text(causes: dict[str, int]) -> str:
    """Number of failed episodes by cause, most frequent first."""
    return ", ".join(f"{cause} {count}" for cause, count in causes.items()) or "none"


def main(config: LeaderboardConfig) -> None:
    """Write LEADERBOARD.md beside the episodes table."""
    from benchmark.results import read_episodes

    folder = Path(config.output_dir)
    episodes = read_episodes(folder)
    if episodes.empty:
        raise SettingError(f"There is no {folder / 'episodes.parquet'}. Make one: python -m benchmark.run")
    with replacing(folder / "LEADERBOARD.md") as path:
        path.write_text(markdown(leaderboard(episodes)))
    print(folder / "LEADERBOARD.md")


if __name__ == "__main__":
    run_command(main, LeaderboardConfig, "leaderboard")
