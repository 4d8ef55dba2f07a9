"""Moving pictures of episodes, as WebP: of a policy, of stored rows, or of a demonstration.

python -m benchmark.record robot=ur3 lambda=0.5 seed_start=50000 output_dir=outputs/videos
python -m benchmark.record row=<id> table=outputs/sweep output_dir=outputs/videos
python -m benchmark.record failed=1 table=outputs/sweep output_dir=outputs/videos
python -m benchmark.record demonstration=0 output_dir=outputs/videos
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.rollouts.video import record, write_film
from benchmark.settings.command import run_command
from benchmark.settings.config import ORACLE_METHODS, RunConfig
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.robot_config import SOURCE
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.rollout import Rollout


@dataclass
class RecordConfig(RunConfig):
    """Draws episodes: of a policy on an arm, or stored ones, or a demonstration."""

    episodes: int = 1
    """Number of episodes, each in a file of its own; a whole number >= 1."""
    row: str = ""
    """A stored row's id, or its first digits, 8 or more, to draw that instead."""
    failed: int = 0
    """How many failed episodes of the table to draw instead; a whole number >= 0."""
    table: str = "results"
    """With row and failed: a folder, of which all tables of episodes are read, or a Parquet file."""
    entry: str = ""
    """With row and failed: folder of the entry that a row is of; empty for our own methods."""
    demonstration: int = -1
    """Seed of a demonstration to draw instead, the source's as benchmark.collect makes it by default; -1 for none."""

    def __post_init__(self) -> None:
        check_setting(not self.suite, "suite", self.suite, "empty: a film is of one condition, by robot and arm.…")
        super().__post_init__()
        check_setting(self.failed >= 0, "failed", self.failed, "a whole number >= 0")
        seeds = f"a seed of demonstrations, from 0 to {VALIDATION.start - 1}, or -1"
        check_setting(-1 <= self.demonstration < VALIDATION.start, "demonstration", self.demonstration, seeds)
        chosen = bool(self.row) + (self.failed > 0) + (self.demonstration >= 0)
        check_setting(chosen <= 1, "row", self.row, "one of row, failed and demonstration at most")
        check_setting(self.wandb.mode == "disabled", "wandb.mode", self.wandb.mode, "disabled: films are files")


def main(config: RecordConfig) -> None:
    """Play what was chosen and write each episode to `output_dir`."""
    from richmap.progress import plain_console

    console = plain_console()
    if config.demonstration >= 0:
        _draw_demonstration(config, console)
    elif config.row or config.failed:
        _draw_rows(config, console)
    else:
        from benchmark.artifacts.known_policies import chosen_checkpoint
        from benchmark.rollouts.chosen_players import rollouts_of
        from benchmark.rollouts.make_rollout import set_stage

        rollout = rollouts_of([set_stage(config, chosen_checkpoint(config), console)])[-1]
        for seed in range(config.seed_start, config.seed_start + config.episodes):
            _draw(rollout, seed, config, console)


def _draw_rows(config: RecordConfig, console: "Console") -> None:
    """Draw stored episodes, played again.

    Raises:
        SettingError: If there are none, or something that one was made with is not here.
    """
    from benchmark.episodes.table import read_tables
    from benchmark.rollouts.row_rollout import row_rollout
    from benchmark.rollouts.stored_rows import chosen_rows

    replay = ReplayConfig(
        table=config.table, task=config.task, row=config.row, robot=config.robot, policy=config.policy,
        entry=config.entry, workers=config.workers, map=config.map, energy=config.energy,
    )  # fmt: skip
    rows = chosen_rows(replay) if config.row else read_tables(Path(config.table), chosen_task(config.task).name)
    if config.failed:
        rows = rows[rows.failure_cause.notna()] if len(rows) else rows
    if not len(rows):
        raise SettingError(
            f"table={config.table} has no failed episodes of {config.task}. Rows of another task need task=…"
        )
    rows = rows[~rows.method.isin(ORACLE_METHODS.values())].head(config.failed or None)
    if not len(rows):
        raise SettingError(f"What was chosen of table={config.table} are a scripted oracle's, which are not drawn.")
    for row in rows.to_dict("records"):
        _draw(row_rollout(row, replay, console), row["episode_seed"], config, console)


def _draw(rollout: "Rollout", seed: int, config: RecordConfig, console: "Console") -> None:
    """Play an episode, write it, and say where it is and what came out."""
    from benchmark.episodes.episode import row_id

    about = rollout.condition
    scale = f"{'lambda' if about.method in ('paper', 'direct') else about.method}{about.guidance_scale:g}"
    slot = {"episode_seed": seed, "slot": seed % about.batch_size}
    name = f"{about.robot}-{about.setting}-{scale}-{seed}-{row_id(about.row() | slot)[:8]}.webp"
    file = Path(config.output_dir) / name
    outcome = record(rollout, seed, file, _caption).outcome
    scores = ", ".join(f"{name} {getattr(outcome, name)}" for name in rollout.task.score_names)
    console.print(f"{file}\n  {_how(outcome)}, {scores}, {outcome.length} steps", soft_wrap=True)


def _caption(episode: "Episode") -> str:
    from benchmark.episodes.arm import setting_text

    about = episode.condition
    method = about.method if about.method == "direct" else f"{about.method} {about.guidance_scale:g}"
    return (
        f"{about.robot}, {setting_text(about.row())}, {method}, policy {about.checkpoint}, "
        f"seed {episode.episode_seed}: {_how(episode.outcome)}"
    )


def _how(outcome: object) -> str:
    cause = getattr(outcome, "failure_cause")  # noqa: B009, every task's outcome has it
    return f"failed by {cause}" if cause else "succeeded"


def _draw_demonstration(config: RecordConfig, console: "Console") -> None:
    import gymnasium

    from benchmark.training.demonstration import demonstrate
    from benchmark.training.demonstration_chunks import kind_of
    from benchmark.training.demonstration_recipe import CollectConfig

    seed, recipe = config.demonstration, CollectConfig(config.task)
    frames: dict[int, list] = {}
    env = gymnasium.make(recipe.demonstrator.environment, render_mode="rgb_array")

    def watch(attempt: int) -> None:
        frames.setdefault(attempt, []).append(env.render())

    kind = kind_of(recipe, seed)
    episode = demonstrate(recipe.demonstrator, env, seed, kind, recipe.burst_probability, recipe.detours, watch)
    env.close()
    file = Path(config.output_dir) / f"{SOURCE}-{config.task}-demonstration-{seed}.webp"
    how = "succeeded" if episode.successes[-1] else "failed"
    write_film(file, frames[episode.attempts][::2], 10, f"{SOURCE}, demonstration, seed {seed}, {kind}: {how}")
    console.print(f"{file}\n  {how}, {len(episode.actions)} steps", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, RecordConfig, "record")
