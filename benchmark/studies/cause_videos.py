"""A moving picture of each cause of failure, of an episode that is stored.

python -m benchmark.studies.cause_videos
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import run_command
from benchmark.settings.config import ORACLE_METHODS, RunConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.recipe import RECIPES
from benchmark.settings.robot_config import PAPER_ARMS
from benchmark.settings.setting import SettingError, check_counts
from envs.block_push.task import BLOCK_PUSH
from richmap.outputs import replacing

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from benchmark.rollouts.rollout import Rollout


TRIED = 3
"""Rows of a cause that are tried, if they were stored by a processor that rounds otherwise than this one."""


@dataclass
class CauseVideosConfig:
    """Replays one stored episode of each cause of failure and shows it, to read the causes against."""

    episodes: str = "results"
    """Folder under which tables of episodes are read, of all seeds."""
    output_dir: str = "results"
    """Folder of causes.md; the pictures go to its folder figures/causes."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""

    def __post_init__(self) -> None:
        check_counts(self, "workers")
        check_folder(self.output_dir)


def main(config: CauseVideosConfig) -> None:
    """Replay an episode of each cause that stored rows have, and write pictures and a table."""
    from benchmark.artifacts.known_policies import RESULTS, policies_in
    from benchmark.episodes.table import read_present
    from benchmark.rollouts.row_rollout import policy_hash, row_rollout
    from benchmark.settings.replay_config import ReplayConfig
    from richmap.progress import plain_console

    console, output_dir = plain_console(), Path(config.output_dir)
    failed = read_present(Path(config.episodes), BLOCK_PUSH)
    if len(failed):
        failed = failed[failed.failure_cause.notna() & ~failed.method.isin(ORACLE_METHODS.values())]
    if not len(failed):
        raise SettingError(f"{config.episodes} holds no failed episodes. Make some: python -m benchmark.run robot=ur3")
    ours = [folder for recipe in RECIPES for folder in policies_in(RESULTS / "checkpoints", recipe)]
    tried, shown = examples(failed, {*map(policy_hash, ours)}), []
    for cause, rows in tried.groupby("failure_cause", sort=False):
        file = output_dir / "figures" / "causes" / f"{cause}.webp"
        for row in rows.to_dict("records"):
            rollout = row_rollout(row, ReplayConfig(table=config.episodes, workers=config.workers), console)
            try:
                film(rollout, row, file, config.episodes)
            except SettingError as error:  # It was stored by a processor that rounds otherwise.
                console.print(f"{cause}: {error}", soft_wrap=True)
                continue
            console.print(str(file), soft_wrap=True)
            shown.append(row)
            break
    with replacing(output_dir / "causes.md") as path:
        path.write_text(markdown(shown))
    console.print(f"Table: {output_dir / 'causes.md'}", soft_wrap=True)


def film(rollout: "Rollout", row: "Mapping[str, Any]", file: Path, table: str) -> None:
    """Play the episode of a row of this table and write it as a moving picture.

    Raises:
        SettingError: If it then fails by something else, or not at all; nothing is written.
    """
    from benchmark.episodes.episode import row_id, row_name
    from benchmark.rollouts.video import record

    with replacing(file) as path:
        outcome = record(rollout, row["episode_seed"], path).outcome
        if outcome.failure_cause != row["failure_cause"]:
            raise SettingError(
                f"{row_name(row)} failed by {row['failure_cause']} and, replayed, by {outcome.failure_cause}. See what "
                f"else differs: python -m benchmark.replay table={table} row={row_id(row)}"
            )


def examples(failed: "pd.DataFrame", policies: set[str]) -> "pd.DataFrame":
    """A few rows for each cause that there is, of our own methods and of these policies.

    Episodes with fewer denoising steps than the default come last; direct transfer comes before guidance, the UR3
    before the paper's other targets, these before the source and that before all others; then seeds.
    """
    order_of = {name: place for place, name in enumerate([*PAPER_ARMS[1:], PAPER_ARMS[0]])}
    ours = failed[(failed.entry_hash == "") & failed.checkpoint_hash.isin(policies)]
    order = ours.assign(
        rushed=ours.sampling_steps < RunConfig().sampling_steps,
        guided=ours["lambda"] > 0,
        arm=ours.robot.map(order_of).fillna(len(order_of)),
    )
    order = order.sort_values(["rushed", "guided", "arm", "episode_seed", "checkpoint", "method", "lambda"])
    return ours.loc[order.index[order.groupby("failure_cause", sort=False).cumcount() < TRIED]]


TEXT = """# Causes of failure, each seen

Made by `python -m benchmark.studies.cause_videos`: one stored episode of each cause, replayed, at twice the speed. The
rules are in `envs/block_push/failure.py`. Any row replays alone: `python -m benchmark.replay table=results row=<row>`.

No stored episode of a policy failed, and fails when it is replayed here, by: {missing}.

| cause | the episode that is shown | |
|---|---|---|
{rows}
"""


def markdown(shown: "list[dict[str, Any]]") -> str:
    """The document, with these rows."""
    from benchmark.episodes.episode import row_id
    from envs.block_push.failure import CAUSES

    by_cause = {row["failure_cause"]: row for row in shown}
    rows = [
        f"| `{cause}` | {row['robot']}, {row['setting']}, {row['method']}, λ {row['lambda']:g}, "
        f"policy {row['checkpoint']}, {row['sampler']} with {row['sampling_steps']} steps, seed {row['episode_seed']}, "
        f"length {row['length']}; row `{row_id(row)}` "
        f"| ![{cause}](figures/causes/{cause}.webp) |"
        for cause in CAUSES
        if (row := by_cause.get(cause))
    ]
    missing = ", ".join(f"`{cause}`" for cause in CAUSES if cause not in by_cause) or "none"
    return TEXT.format(rows="\n".join(rows), missing=missing)


if __name__ == "__main__":
    run_command(main, CauseVideosConfig, "cause_videos")
