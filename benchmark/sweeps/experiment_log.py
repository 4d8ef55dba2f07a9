"""Experiments in Weights & Biases: online, kept on disk, or not at all.

Artifacts make one chain: two maps -> energy field -> evaluation <- checkpoint <- validation. A map is logged as a small
description: from its settings `benchmark.build_maps` builds the same file again, byte for byte.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.artifacts.wandb_run import checkpoint_artifact, start_experiment, unharmed
from benchmark.settings.config import RunConfig, WandbConfig
from richmap.progress import progress_bar

if TYPE_CHECKING:
    import pandas as pd
    import wandb

    from benchmark.rollouts.players import Player
    from benchmark.rollouts.rollout import Rollout
    from benchmark.scoring.suite_table import Standing
    from envs.task import Task
    from richmap.maps.reachability_map import ReachabilityMap


def log_run(config: RunConfig, players: "Sequence[Player]", tables: "Sequence[pd.DataFrame]") -> None:
    """All that a command rolled out, with a bar: W&B takes its time; what it does not take is said in a line."""
    if config.wandb.mode == "disabled":
        return
    with progress_bar() as progress:
        each = [*zip(players, tables, strict=True)]
        for player, rows in progress.track(each, description="W&B, rollouts"):
            with unharmed():
                log_field(config, player, config.output_dir)
                log_evaluation(config, player, rows, config.output_dir)
    with unharmed():
        log_curves(players[0].task, config.wandb, tables, config.output_dir)
    if config.wandb.mode == "offline":
        runs = Path(config.wandb.folder, "wandb", "offline-run-*")
        print(f"W&B: the runs are kept on disk. To upload them: wandb sync {runs}")


def log_field(config: RunConfig, player: "Player", group: str) -> None:
    """The field that guidance looks at, if it looks at one, as a W&B run: it uses the maps, and makes the field."""
    if config.wandb.mode == "disabled" or player.kind is None:
        return
    from benchmark.artifacts.fields import made_of
    from benchmark.rollouts.rollout import Rollout
    from richmap.progress import plain_console

    assert isinstance(player, Rollout)  # Nobody else is guided.
    rollout, of_map = player, config.map
    arm, kind = rollout.arm, str(rollout.kind)
    about = {"field": kind, "robot": arm.robot, "base": arm.base, "map": of_map.construction}
    with start_experiment(config.wandb, f"{kind} field, {arm.robot}", group, "field", about) as run:
        for reachability_map in made_of(kind, arm, of_map, config.workers, plain_console(quiet=True)):
            _use(run, _map(reachability_map))
        run.log_artifact(_field(rollout))


def log_evaluation(config: RunConfig, player: "Player", episodes: "pd.DataFrame", group: str) -> None:
    """What a policy did as a W&B run: settings, every episode, scores with intervals over lambda, causes, what it used;
    nothing of a scripted oracle.

    Args:
        config: Settings of the run; its lambda and method need not be the player's.
        player: Who played.
        episodes: Rows of the episodes table, all of this player.
        group: What the run belongs to, if the settings do not say.
    """
    if config.wandb.mode == "disabled":
        return
    import wandb

    from benchmark.episodes.episode import plain
    from benchmark.rollouts.rollout import Rollout
    from benchmark.scoring.scores import figures

    if not isinstance(player, Rollout):
        return
    rollout = player
    condition = {name: plain(value) for name, value in rollout.condition.row().items()}
    settings = asdict(config) | condition
    del settings["guidance_scale"]  # It is called lambda.
    name = "{robot}-{setting}-{method}-{lambda:g}-{checkpoint}".format_map(condition)
    cells = [[plain(value) for value in row] for row in episodes.to_numpy(object)]
    point = {"lambda": condition["lambda"], **figures(episodes, rollout.task)}
    failed = {f"failed/{cause}": count for cause, count in point.pop("causes").items()}
    with start_experiment(config.wandb, name, group, "evaluation", settings) as run:
        _use(run, checkpoint_artifact(rollout.checkpoint))
        if rollout.field:
            _use(run, _field(rollout))
        run.define_metric("*", step_metric="lambda")
        run.log(point | failed | {"episodes": wandb.Table([*episodes], cells)})
        if config.wandb.video:
            _log_video(run, rollout, int(episodes.episode_seed.min()))


def log_curves(task: "Task", config: WandbConfig, tables: "Iterable[pd.DataFrame]", group: str) -> None:
    """Scores over lambda, of all policies together, as one W&B run for each arm, setting and method.

    Intervals hold for other trainings and other episodes, as on the leaderboard.

    Args:
        task: What the episodes are of.
        config: Whether and where to log.
        tables: Rows of the episodes table, of any conditions.
        group: What the runs belong to, if the settings do not say.
    """
    if config.mode == "disabled" or not (stored := [table for table in tables if len(table)]):
        return
    import pandas as pd

    from benchmark.scoring.scale_table import CHOSEN_FOR, scale_table

    points = scale_table(pd.concat(stored, ignore_index=True), task, task.score_names)
    shown = [f"{score}{end}" for score in task.score_names for end in ("", "_low", "_high", "_difference")]
    is_direct = points.method == "direct"
    points.loc[is_direct, [name for name in shown if name.endswith("_difference")]] = math.nan  # To itself.
    alike = [*CHOSEN_FOR, "method", "field_fingerprint", "entry_hash"]
    curves = [curve for _, curve in points[~is_direct].groupby(alike, sort=False)]
    with progress_bar() as progress:
        for curve in progress.track(curves, description="W&B, curves"):
            first = curve.iloc[0]
            of_arm = (points[CHOSEN_FOR] == first[CHOSEN_FOR]).all(axis=1)
            name = f"{first.robot}-{first.setting}-{first.method}"
            with start_experiment(config, name, group, "curve", first[[*CHOSEN_FOR, "method"]].to_dict()) as run:
                run.define_metric("curve/*", step_metric="lambda")
                for part in (points[of_arm & is_direct], curve.sort_values("lambda")):
                    named = part[["n", *shown]].add_prefix("curve/").assign(**{"lambda": part["lambda"]})
                    for _, row in named.iterrows():
                        run.log(row.dropna().to_dict())


def log_standing(config: WandbConfig, of: "Standing", group: str) -> None:
    """What methods come to on a suite, as one W&B run: the ranking, what they do on each condition, and the share of
    head-room of each in its summary.

    Args:
        config: Whether and where to log.
        of: What they come to.
        group: What the run belongs to, if the settings do not say.
    """
    if config.mode == "disabled" or of.ranking.empty:
        return
    import wandb

    from benchmark.episodes.episode import plain

    shown = {"ranking": of.methods.drop(columns="scales"), "conditions": of.table}
    with unharmed(), start_experiment(config, f"suite {of.suite}", group, "suite", {"suite": of.suite}) as run:
        for name, table in shown.items():
            cells = [[plain(value) for value in row] for row in table.to_numpy(object)]
            run.log({name: wandb.Table([*table], cells, allow_mixed_types=True)})
        for _, row in of.methods.iterrows():
            for figure in ("share", "gain"):
                run.summary[f"{figure}/{row.method} {row['lambda']}"] = float(row[figure])


def _log_video(run: "wandb.Run", rollout: "Rollout", seed: int) -> None:
    """One episode as a GIF; a line that says why not, where nothing can be drawn."""
    import wandb

    from benchmark.rollouts.video import record

    with TemporaryDirectory() as folder:
        file = Path(folder, f"{seed}.gif")
        try:
            record(rollout, seed, file)
        except Exception as error:  # Whatever the graphics driver of this machine raises.
            print(f"W&B: no video of episode {seed}. {type(error).__name__}: {' '.join(str(error).split())}")
            return
        run.log({"video": wandb.Video(str(file), format="gif")})


def _use(run: "wandb.Run", artifact: "wandb.Artifact") -> None:
    """Declare an artifact as what a run started from.

    `Run.use_artifact` does this by the same call, but waits for the server, and refuses to work offline.
    """
    run._log_artifact(artifact, is_user_created=True, use_after_commit=True)


def _field(rollout: "Rollout") -> "wandb.Artifact":
    """The file of a rollout's field; like a checkpoint's it is not copied."""
    import wandb

    condition = rollout.condition
    assert rollout.field is not None  # Asked for only where guidance looks at one.
    about = {"kind": str(rollout.kind), "target": condition.robot, "fingerprint": condition.field_fingerprint}
    artifact = wandb.Artifact(f"field-{about['target']}-{about['fingerprint'][:12]}", type="field", metadata=about)
    artifact.add_file(str(rollout.field.resolve()), policy="immutable", skip_cache=True)
    return artifact


def _map(reachability_map: "ReachabilityMap") -> "wandb.Artifact":
    """What a map holds and how it was built, in place of its hundreds of megabytes."""
    import wandb

    built = reachability_map.construction
    about = {
        "content_hash": reachability_map.content_hash,
        "robot": built.robot,
        "robot_fingerprint": built.robot_fingerprint,
        "theta": built.theta,
        "grid": asdict(reachability_map.grid),
        "directions": reachability_map.inserted,
        "occupancy": reachability_map.occupancy,
        "construction": asdict(built),
    }
    artifact = wandb.Artifact(
        f"map-{built.robot}-{reachability_map.content_hash[:12]}",
        type="reachability-map",
        description="How a reachability map was built; python -m benchmark.build_maps with these settings builds the "
        "same map again, byte for byte.",
        metadata=about,
    )
    with TemporaryDirectory() as folder:
        file = Path(folder, "map.json")
        file.write_text(json.dumps(about, indent=2))
        artifact.add_file(str(file))  # Copied: the file of `Artifact.new_file` goes away with this process.
    return artifact
