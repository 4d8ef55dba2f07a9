"""Experiments in Weights & Biases: online, kept on disk, or not at all.

Artifacts make one chain: two maps -> energy field -> evaluation <- checkpoint <- validation. A map is logged as a small
description: from its settings `benchmark.build_maps` builds the same file again, byte for byte.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.checkpoint import Checkpoint
from benchmark.config import SETTINGS, MapConfig, RunConfig, WandbConfig
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd
    import wandb

    from benchmark.rollout import Rollout
    from envs.arms import ArmSetting
    from richmap.reachability_map import ReachabilityMap

PATIENCE = 30
"""How long W&B's server is waited for, at the start and at the end of a run, in [s]; one request a third of it."""


def start_experiment(
    config: WandbConfig, name: str, group: str, kind: str, settings: Mapping[str, object]
) -> "wandb.Run":
    """A W&B run, to be used in a `with` statement; one that does nothing if the mode is disabled.

    Where the server cannot be reached, or knows no such user, what would go there is kept on disk. Nothing is asked.

    Args:
        config: Whether and where to log.
        name: Of the run, such as seed42.
        group: What the run belongs to, if the settings do not say.
        kind: Job type: train, validate, field, evaluation or curve.
        settings: What the run was made with, as plain values.
    """
    import wandb

    def start(mode: str) -> "wandb.Run":
        quiet = wandb.Settings(
            mode=mode,
            silent=True,
            console="off",
            init_timeout=PATIENCE,
            finish_timeout=PATIENCE,
            x_graphql_timeout_seconds=PATIENCE / 3,
            x_graphql_retry_max=1,
        )
        wandb.setup(quiet)  # Only here does `silent` hold for messages that belong to no run, and for prompts.
        return wandb.init(
            project=config.project,
            name=name,
            group=config.group or group,
            job_type=kind,
            config=dict(settings),
            dir=config.folder,
            settings=quiet,
        )

    unreachable = config.mode == "online" and os.environ.get("WANDB_MODE") == "offline"
    try:
        return start("offline" if unreachable else config.mode)
    except wandb.Error as error:
        print(f"W&B: {' '.join(str(error).split())} What would go there is kept in {config.folder}: wandb sync.")
        os.environ["WANDB_MODE"] = "offline"  # The next run, and a sweep's next job, need not wait again.
        return start("offline")


@contextmanager
def unharmed() -> Iterator[None]:
    """What W&B, its folder or its server do not take costs what would have been logged, and a line, not the run."""
    try:
        yield
    except Exception as error:
        print(f"W&B: not logged. {type(error).__name__}: {' '.join(str(error).split())}")


def log_checkpoint(run: "wandb.Run", folder: Path) -> None:
    """A checkpoint that the run made. Its files are not copied: they have to stay until they are uploaded."""
    if not run.disabled:
        run.log_artifact(_checkpoint(folder))


def log_field(config: RunConfig, rollout: "Rollout", group: str) -> None:
    """The field that guidance looks at as a W&B run, once in a process: it uses the maps, and makes the field."""
    if config.wandb.mode == "disabled" or rollout.field is None:
        return
    from benchmark.arm import chosen_arm

    kind = METHODS[rollout.condition.method].field
    _log_field(kind, chosen_arm(config), config.map, config.workers, rollout.field, config.wandb, group)


@cache
def _log_field(
    kind: str, arm: "ArmSetting", of_map: MapConfig, workers: int, field: Path, config: WandbConfig, group: str
) -> None:
    from rich.console import Console

    from benchmark.build_maps import compared_maps
    from richmap.robots import load_robot

    maps = ()
    if kind == "energy":
        maps = compared_maps(load_robot(arm.robot), arm.base, of_map, workers, Console(quiet=True))
    about = {"field": kind, "robot": arm.robot, "base": arm.base, "map": asdict(of_map)}
    with start_experiment(config, f"{kind} field, {arm.robot}", group, "field", about) as run:
        for reachability_map in maps:
            _use(run, _map(reachability_map))
        run.log_artifact(_field(field))


def log_evaluation(config: RunConfig, rollout: "Rollout", episodes: "pd.DataFrame", group: str) -> None:
    """One rollout as a W&B run: settings, every episode, scores with intervals over lambda, causes, what it used.

    Args:
        config: Settings of the run; its lambda and method need not be the rollout's.
        rollout: What was rolled out.
        episodes: Rows of the episodes table, all of this rollout.
        group: What the run belongs to, if the settings do not say.
    """
    if config.wandb.mode == "disabled":
        return
    import wandb

    from benchmark.results import plain
    from benchmark.scores import figures

    condition = {name: plain(value) for name, value in rollout.condition.row().items()}
    settings = asdict(config) | condition
    del settings["guidance_scale"]  # It is called lambda.
    name = "{robot}-{setting}-{method}-{lambda:g}-{checkpoint}".format_map(condition)
    columns = [name for name in episodes if name not in ("path_x", "path_y")]
    cells = [[plain(value) for value in row] for row in episodes[columns].to_numpy(object)]
    point = {"lambda": condition["lambda"], **figures(episodes)}
    failed = {f"failed/{cause}": count for cause, count in point.pop("causes").items()}
    with start_experiment(config.wandb, name, group, "evaluation", settings) as run:
        _use(run, _checkpoint(rollout.checkpoint))
        if rollout.field:
            _use(run, _field(rollout.field))
        run.define_metric("*", step_metric="lambda")
        run.log(point | failed | {"episodes": wandb.Table(columns, cells)})
        if config.wandb.video:
            _log_video(run, rollout, int(episodes.episode_seed.min()))


def log_curves(config: WandbConfig, tables: "Iterable[pd.DataFrame]", group: str) -> None:
    """Scores over lambda, of all policies together, as one W&B run for each arm, setting and method.

    Intervals hold for other trainings and other episodes, as on the leaderboard.

    Args:
        config: Whether and where to log.
        tables: Rows of the episodes table, of any conditions.
        group: What the runs belong to, if the settings do not say.
    """
    if config.mode == "disabled" or not (stored := [table for table in tables if len(table)]):
        return
    import pandas as pd

    from benchmark.arm import ARM
    from benchmark.ranking import SAMPLING, Protocol, leaderboard
    from benchmark.scores import SCORES

    alike = [*ARM, *SAMPLING, "code_version"]
    episodes = pd.concat(stored, ignore_index=True)
    by_hash = episodes.assign(checkpoint=episodes.checkpoint_hash)  # Two policies may go by one name.
    seeds, policies = episodes.episode_seed.nunique(), by_hash.checkpoint.nunique()
    slots = episodes.batch_shape.iloc[0]  # Those of other batches are other curves.
    protocol = Protocol("sweep", SETTINGS, seeds, slots, policies, tuple(SCORES), best_only=False)
    points = leaderboard(by_hash, protocol)
    shown = [f"{score}{end}" for score in SCORES for end in ("", "_low", "_high", "_difference")]
    guided = points[points.method != "direct"]
    for _, curve in guided.groupby([*alike, "method", "field_fingerprint", "entry_hash"], sort=False):
        first = curve.iloc[0]
        unguided = points[(points.method == "direct") & (points[alike] == first[alike]).all(axis=1)]
        name = f"{first.robot}-{first.setting}-{first.method}"
        with start_experiment(config, name, group, "curve", first[[*alike, "method"]].to_dict()) as run:
            run.define_metric("curve/*", step_metric="lambda")
            for part in (unguided, curve.sort_values("lambda")):
                for _, row in part[["n", *shown]].add_prefix("curve/").assign(**{"lambda": part["lambda"]}).iterrows():
                    run.log(row.dropna().to_dict())  # Direct transfer has no difference to itself.


def _log_video(run: "wandb.Run", rollout: "Rollout", seed: int) -> None:
    """One episode as a GIF; a line that says why not, where nothing can be drawn."""
    import wandb

    from benchmark.record import record

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


def _checkpoint(folder: Path) -> "wandb.Artifact":
    """A checkpoint under the same name wherever it lies, so that a training and its evaluations are linked."""
    import wandb

    checkpoint = Checkpoint(folder)
    name = f"{checkpoint.name.replace('/', '-')}-{checkpoint.policy_hash[:12]}"
    artifact = wandb.Artifact(name, type="model", metadata={"policy_hash": checkpoint.policy_hash})
    artifact.add_dir(str(folder.resolve()), policy="immutable", skip_cache=True)
    return artifact


def _field(file: Path) -> "wandb.Artifact":
    """A field's file; like a checkpoint's it is not copied."""
    import wandb

    from richmap.energy import EnergyField

    about = EnergyField.load(file).about
    artifact = wandb.Artifact(f"field-{about['target']}-{about['fingerprint'][:12]}", type="field", metadata=about)
    artifact.add_file(str(file.resolve()), policy="immutable", skip_cache=True)
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
