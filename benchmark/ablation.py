"""What each choice of the source policies' recipe bought: one changed at a time, several training seeds each.

python -m benchmark.ablation
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.collect import CollectConfig
from benchmark.command import check_setting, run_command
from benchmark.config import RobotConfig, RunConfig, check_folder, check_seeds
from benchmark.outputs import replacing
from benchmark.run import CHECKPOINTS, make_rollout, run_and_store_all
from benchmark.source_policies import CLEAN
from benchmark.train import TrainConfig

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

STEP_SECONDS, EPISODE_SECONDS, DDPM_EPISODE_SECONDS = 0.03, 1.1, 2.0
"""What one training step and one episode take on one core, roughly, in [s]; for the budget alone."""


@dataclass(frozen=True)
class Variant:
    """The default recipe with one thing changed."""

    text: str
    """What is changed."""
    demonstrations: CollectConfig = field(default_factory=CollectConfig)
    policy: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that are changed in training."""
    n_action_steps: int = 1
    """Predicted actions that are executed before the next prediction."""
    sampler: str = "DDIM"
    sampling_steps: int = 10

    @property
    def trained(self) -> bool:
        """Whether it has weights of its own; otherwise it has the default's."""
        return self == VARIANTS["default"] or bool(self.policy) or self.demonstrations != CollectConfig()


def _data(name: str, **changes: Any) -> CollectConfig:
    return CollectConfig(**changes, output_dir=f"demonstrations/{name}")


VARIANTS = {
    "default": Variant("the recipe of the source policies"),
    "absolute": Variant("positions on the table alone, no offsets from the tool", policy={"features": "absolute"}),
    "pair": Variant("the oracle's own geometry in the inputs", policy={"features": "pair"}),
    "no_bursts": Variant("no bursts", _data("no_bursts", burst_probability=0.0)),
    "no_wide": Variant("no scenes all over the table", _data("no_wide", share_wide=0.0, share_bursts=0.6)),
    "no_crowded": Variant("no scenes with things close", _data("no_crowded", share_crowded=0.0, share_bursts=0.45)),
    "usual_scenes": Variant(
        "neither of the two", _data("usual_scenes", share_wide=0.0, share_crowded=0.0, share_bursts=0.7)
    ),
    "no_detours": Variant("the oracle's straight ways, also through blocks", _data("no_detours", detours=False)),
    "on_policy": Variant(
        "an earlier policy drives in 15 % of the episodes, in place of bursts",
        _data("on_policy", share_bursts=0.2, share_on_policy=0.15, driver=str(CHECKPOINTS[0] / "seed42-1")),
    ),
    "clean": Variant("undisturbed demonstrations alone", CLEAN),
    "clean_displaced": Variant("the same, and the effector displaced in training", CLEAN, {"displacement": 0.005}),
    "no_permutation": Variant("blocks and targets not relabelled", policy={"permute": False}),
    "x0": Variant("the network predicts the actions, not the noise", policy={"prediction_type": "sample"}),
    "n_obs_1": Variant("one observation, not three", policy={"n_obs_steps": 1}),
    "n_obs_2": Variant("two observations, not three", policy={"n_obs_steps": 2}),
    "n_action_2": Variant("two actions are executed before the next prediction, not one", n_action_steps=2),
    "n_action_4": Variant("four actions are executed before the next prediction, not one", n_action_steps=4),
    "ddpm": Variant("DDPM with 100 steps, not DDIM with 10", sampler="DDPM", sampling_steps=100),
}


@dataclass
class AblationConfig:
    """Trains and evaluates the source policies' recipe with one choice changed at a time."""

    variants: list[str] = field(default_factory=lambda: list(VARIANTS))
    """Which, as in variants=[x0,pair]; the default is always among them, since the others are compared with it."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of each, whole numbers >= 0."""
    steps: int = 9000
    """Optimiser steps of a training; the last policy counts."""
    episodes: int = 200
    """Validation episodes of each policy on the xArm6; a whole number >= 1."""
    seed_start: int = 50_000
    """Seed of the first validation episode."""
    device: str = "cpu"
    """Where policies are trained and run: cpu or cuda."""
    output_dir: str = "results"
    """Folder of ablation.md; the episodes go to its folder ablation, the policies to outputs/ablation."""
    workers: int = 2
    """Processes that simulate, train or roll out; results do not depend on it. A whole number >= 1."""

    def __post_init__(self) -> None:
        for name in self.variants:
            check_setting(name in VARIANTS, "variants", name, ", ".join(VARIANTS))
        check_setting(bool(self.seeds) and min(self.seeds) >= 0, "seeds", self.seeds, "whole numbers >= 0")
        for name in ("steps", "episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_seeds(self.seed_start, self.episodes)
        check_setting(self.device in ("cpu", "cuda"), "device", self.device, "cpu, cuda")
        check_folder(self.output_dir)

    @property
    def chosen(self) -> dict[str, Variant]:
        """The variants in the table's order, the default first."""
        return {name: variant for name, variant in VARIANTS.items() if name == "default" or name in self.variants}


def main(config: AblationConfig) -> None:
    """Say what it takes, train and evaluate what is missing, and write the table; a killed run goes on where it was."""
    import pandas as pd
    from rich.console import Console

    from benchmark.side_by_side import train_all

    console = Console()
    console.print(budget(config))
    trained = [name for name, variant in config.chosen.items() if variant.trained]
    train_all([training(name, seed, config) for name in trained for seed in config.seeds], config.workers)
    episodes = pd.concat([evaluate(name, config, console) for name in config.chosen], ignore_index=True)
    file = Path(config.output_dir) / "ablation.md"
    with replacing(file) as path:
        path.write_text(markdown(summary(episodes), config))
    console.print(f"Table: {file}", soft_wrap=True)


def budget(config: AblationConfig) -> str:
    """What the whole ablation takes, without what is stored already."""
    trainings = sum(variant.trained for variant in config.chosen.values()) * len(config.seeds)
    data = {variant.demonstrations.output_dir: variant.demonstrations.episodes for variant in config.chosen.values()}
    demonstrations, rollouts = sum(data.values()), len(config.chosen) * len(config.seeds) * config.episodes
    seconds = trainings * config.steps * STEP_SECONDS + demonstrations * EPISODE_SECONDS
    for variant in config.chosen.values():
        slow = DDPM_EPISODE_SECONDS if variant.sampler == "DDPM" else EPISODE_SECONDS
        seconds += len(config.seeds) * config.episodes * slow
    return (
        f"Budget: {demonstrations} demonstrations, {trainings} trainings of {config.steps} steps, {rollouts} episodes: "
        f"about {seconds / config.workers / 3600:.1f} h with {config.workers} workers, less what is stored already."
    )


def training(name: str, seed: int, config: AblationConfig) -> TrainConfig:
    """The training of a variant's own weights."""
    variant = VARIANTS[name]
    return TrainConfig(
        seed=seed,
        steps=config.steps,
        keep=[config.steps],
        device=config.device,
        policy=dict(variant.policy),
        demonstrations=variant.demonstrations,
        output_dir=f"outputs/ablation/{name}",
    )


def checkpoint(name: str, seed: int, config: AblationConfig) -> Path:
    """Folder of a variant's policy; one without weights of its own is made from the default's where it must."""
    variant = VARIANTS[name]
    (path,) = training(name if variant.trained else "default", seed, config).checkpoints.values()
    if variant.n_action_steps == 1:
        return path
    copy = Path("outputs") / "ablation" / name / path.name
    if not copy.exists():
        partial = copy.with_name(f".{copy.name}.tmp")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(path, partial)
        settings = json.loads((partial / "config.json").read_text())
        (partial / "config.json").write_text(json.dumps({**settings, "n_action_steps": variant.n_action_steps}))
        os.replace(partial, copy)
    return copy


def evaluate(name: str, config: AblationConfig, console: "Console") -> "pd.DataFrame":
    """The episodes of all of a variant's policies, with its name in the column `variant`."""
    import pandas as pd

    variant = VARIANTS[name]
    run = RunConfig(
        robot=RobotConfig("xarm6"),
        episodes=config.episodes,
        seed_start=config.seed_start,
        sampler=variant.sampler,
        sampling_steps=variant.sampling_steps,
        device=config.device,
        workers=config.workers,
        output_dir=str(Path(config.output_dir) / "ablation" / name),
    )
    paths = [checkpoint(name, seed, config) for seed in config.seeds]
    rollouts = [make_rollout(run, 0.0, path, console) for path in paths]
    return pd.concat(run_and_store_all(rollouts, run, name, console), ignore_index=True).assign(variant=name)


def summary(episodes: "pd.DataFrame") -> "pd.DataFrame":
    """One row per variant: scores over all its policies, p2 of each training seed, and p2 less the default's.

    The interval of a mean is Wilson's over all its episodes, that of the difference is over episodes that share scene
    and training seed. Neither knows how much training seeds differ: for that the seeds' own p2 are there.

    Args:
        episodes: Rows of all policies with the column `variant`; those of the variant `default` come first.
    """
    import pandas as pd

    from benchmark.statistics import paired_difference, rate_interval

    key = ["training_seed", "episode_seed"]
    default = episodes[episodes.variant == "default"].set_index(key).p2
    rows = []
    for name, table in episodes.groupby("variant", sort=False):
        p2 = table.set_index(key).p2
        low, high = rate_interval(p2.to_numpy(dtype=float))
        difference = paired_difference(p2.to_numpy(dtype=float), default.loc[p2.index].to_numpy(dtype=float))
        rows.append(
            {"variant": name, "n": len(table), "p2": p2.mean(), "p2_low": low, "p2_high": high}
            | {"by_seed": p2.groupby("training_seed").mean().to_dict()}
            | dict(zip(("difference", "difference_low", "difference_high"), difference, strict=True))
            | {"p1": table.p1.mean(), "score": table.score.mean(), "length": table.length.mean()}
        )
    return pd.DataFrame(rows)


def markdown(table: "pd.DataFrame", config: AblationConfig) -> str:
    """The summary as a document."""
    import pandas as pd

    from benchmark.code_version import code_version
    from benchmark.scores import difference_text, with_interval

    shown = pd.DataFrame(
        {
            "variant": table.variant,
            "what is changed": [VARIANTS[name].text for name in table.variant],
            "n": table.n,
            "p2": [with_interval(row, "p2") for _, row in table.iterrows()],
            "p2 by training seed": [", ".join(f"{100 * p2:.1f}" for p2 in seeds.values()) for seeds in table.by_seed],
            "p2 less the default's": [difference_text(row) for _, row in table.iterrows()],
            "p1": (100 * table.p1).map("{:.1f}".format),
            "score": (100 * table.score).map("{:.1f}".format),
            "steps": table.length.map("{:.0f}".format),
        }
    )
    last = config.seed_start + config.episodes - 1
    return "\n".join(
        [
            "# What each choice bought",
            "",
            f"Made by `python -m benchmark.ablation`, code version {code_version()}. The source policies' recipe with",
            f"one choice changed at a time, {config.steps} training steps, the last policy of each training seed",
            f"({', '.join(map(str, config.seeds))}), on the xArm6, setting embodied, validation seeds",
            f"{config.seed_start} to {last}, percent. Brackets: 95 % intervals over episodes (Wilson; paired for",
            "differences); how much training seeds differ is seen from their own figures.",
            "",
            shown.to_markdown(index=False),
            "",
        ]
    )


if __name__ == "__main__":
    run_command(main, AblationConfig, "ablation")
