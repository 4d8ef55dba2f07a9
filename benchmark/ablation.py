"""What each choice of the source policies' recipe bought: choice by demonstrations, several training seeds each.

python -m benchmark.ablation
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.command import check_setting, run_command
from benchmark.config import RobotConfig, RunConfig, check_folder, check_seeds
from benchmark.demonstration_recipe import CollectConfig
from benchmark.known_policies import CHECKPOINTS
from benchmark.make_rollout import make_rollout
from benchmark.missing_episodes import run_and_store_all
from benchmark.outputs import replacing
from benchmark.source_policies import CLEAN
from benchmark.train import TrainConfig

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.statistics import Crossed

STEP_SECONDS, EPISODE_SECONDS, DDPM_EPISODE_SECONDS = 0.027, 0.5, 2.0
"""What one training step and one episode take on one core, roughly, in [s]; for the budget alone."""


@dataclass(frozen=True)
class Variant:
    """A recipe that differs from another in one thing."""

    text: str
    """What is changed."""
    base: str = "default"
    """The variant that it differs from; empty for the one that differs from none."""
    demonstrations: CollectConfig = field(default_factory=CollectConfig)
    policy: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that are changed in training."""
    n_action_steps: int = 1
    """Predicted actions that are executed before the next prediction."""
    sampler: str = "DDIM"
    sampling_steps: int = 10

    @property
    def trained(self) -> bool:
        """Whether it has weights of its own; otherwise it has those of its base."""
        return not self.base or bool(self.policy) or self.demonstrations != VARIANTS[self.base].demonstrations


def _data(name: str, **changes: Any) -> CollectConfig:
    return CollectConfig(**changes, output_dir=f"demonstrations/{name}")


CHOICES = {
    "absolute": Variant("positions on the table alone, no offsets from the tool", policy={"features": "absolute"}),
    "pair": Variant("the oracle's own geometry in the inputs", policy={"features": "pair"}),
    "no_permutation": Variant("blocks and targets not relabelled", policy={"permute": False}),
    "x0": Variant("the network predicts the actions, not the noise", policy={"prediction_type": "sample"}),
    "n_obs_1": Variant("one observation, not three", policy={"n_obs_steps": 1}),
    "n_action_2": Variant("two actions executed before the next prediction, not one", n_action_steps=2),
    "n_action_4": Variant("four actions executed before the next prediction, not one", n_action_steps=4),
    "ddpm": Variant("DDPM with 100 steps, not DDIM with 10", sampler="DDPM", sampling_steps=100),
}
"""What can be chosen with any demonstrations."""

DISPLACED = {"displacement": 0.005}

BEST_OF_CLEAN = DISPLACED | CHOICES["n_obs_1"].policy

NETWORKS = {
    "half": Variant("a network of half the width", policy={"trunk_width": 168, "head_width": 64}),
    "double": Variant("a network of twice the width", policy={"trunk_width": 672, "head_width": 256}),
    "horizon_8": Variant("eight actions predicted at once, not four", policy={"horizon": 8}),
}
"""What else can be chosen of the network."""

VARIANTS = {
    "default": Variant("the recipe of the source policies", base=""),
    **CHOICES,
    "no_bursts": Variant("no bursts", demonstrations=_data("no_bursts", burst_probability=0.0)),
    "no_wide": Variant(
        "no scenes all over the table", demonstrations=_data("no_wide", share_wide=0.0, share_bursts=0.6)
    ),
    "no_detours": Variant(
        "the oracle's straight ways, also through blocks", demonstrations=_data("no_detours", detours=False)
    ),
    "on_policy": Variant(
        "a policy of the recipe drives in 15 % of the episodes, in place of bursts",
        demonstrations=_data(
            "on_policy", share_bursts=0.2, share_on_policy=0.15, driver=str(CHECKPOINTS[0] / "seed42-1")
        ),
    ),
    "clean": Variant("undisturbed demonstrations alone", demonstrations=CLEAN),
    **{f"clean_{name}": replace(choice, base="clean", demonstrations=CLEAN) for name, choice in CHOICES.items()},
    "clean_displaced": Variant("the effector displaced in training", "clean", CLEAN, DISPLACED),
    **{
        f"clean_displaced_{name}": replace(
            CHOICES[name], base="clean_displaced", demonstrations=CLEAN, policy=DISPLACED | CHOICES[name].policy
        )
        for name in ("n_obs_1", "pair")
    },
    **{
        f"clean_best_{name}": replace(
            choice, base="clean_displaced_n_obs_1", demonstrations=CLEAN, policy=BEST_OF_CLEAN | choice.policy
        )
        for name, choice in {"pair": CHOICES["pair"], "x0": CHOICES["x0"], **NETWORKS}.items()
    },
}


@dataclass
class AblationConfig:
    """Trains and evaluates the source policies' recipe with one choice changed at a time."""

    variants: list[str] = field(default_factory=lambda: list(VARIANTS))
    """Which, as in variants=[x0,pair]; what they are compared with is always among them."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of each, whole numbers >= 0."""
    steps: int = 4500
    """Optimiser steps of a training, half of the source policies'; the last policy counts."""
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
        """The variants in the table's order, each with what it is compared with."""
        asked = {*self.variants}
        for name in reversed(VARIANTS):  # A base stands before its variants.
            asked |= {VARIANTS[name].base} if name in asked else set()
        return {name: variant for name, variant in VARIANTS.items() if name in asked}


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
    """Folder of a variant's policy; one without weights of its own is made from its base's where it must."""
    variant = VARIANTS[name]
    (path,) = training(name if variant.trained else variant.base, seed, config).checkpoints.values()
    if variant.n_action_steps == 1:
        return path
    copy = path.with_name(f"{path.name}-n_action_{variant.n_action_steps}")
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
    """One row per variant: scores over all its policies, p2 of each training seed, and p2 less that of its base.

    Intervals are for other training seeds and other episodes; differences are of the same of both.

    Args:
        episodes: Rows of all policies with the column `variant`.
    """
    import pandas as pd

    from benchmark.statistics import clustered_difference, clustered_mean

    key, rows = ["training_seed", "episode_seed"], []
    p2 = episodes.set_index(["variant", *key]).p2.astype(float)
    for name, table in episodes.groupby("variant", sort=False):
        own = p2[name]
        less = own - p2[VARIANTS[name].base or name].loc[own.index]
        mean, low, high = clustered_mean(_crossed(own))
        difference, least, most = clustered_difference(_crossed(less))
        rows.append(
            {"variant": name, "n": len(table), "p2": mean, "p2_low": low, "p2_high": high}
            | {"by_seed": own.groupby("training_seed").mean().to_dict()}
            | {"difference": difference, "difference_low": least, "difference_high": most}
            | {"p1": table.p1.mean(), "score": table.score.mean(), "length": table.length.mean()}
        )
    return pd.DataFrame(rows)


def _crossed(values: "pd.Series") -> "Crossed":
    from benchmark.statistics import Crossed

    seeds = values.index
    return Crossed(values.to_numpy(), *(seeds.get_level_values(name).to_numpy() for name in seeds.names))


def markdown(table: "pd.DataFrame", config: AblationConfig) -> str:
    """The summary as a document."""
    import pandas as pd

    from benchmark.code_version import code_version
    from benchmark.scores import difference_text, with_interval

    shown = pd.DataFrame(
        {
            "variant": table.variant,
            "what is changed": [VARIANTS[name].text for name in table.variant],
            "of": [VARIANTS[name].base for name in table.variant],
            "n": table.n,
            "p2": [with_interval(row, "p2") for _, row in table.iterrows()],
            "p2 by training seed": [", ".join(f"{100 * p2:.1f}" for p2 in seeds.values()) for seeds in table.by_seed],
            "p2 less that": [difference_text(row) if VARIANTS[row.variant].base else "" for _, row in table.iterrows()],
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
            "one choice changed; `clean_…` are choices changed with undisturbed demonstrations alone, with more",
            f"to gain; `clean_best_…` on top of the best two; {config.steps} training steps, the last policy of each",
            f"training seed ({', '.join(map(str, config.seeds))}), on the xArm6, setting embodied, validation seeds",
            f"{config.seed_start} to {last}, percent. Brackets: 95 % intervals for other training seeds and other",
            "episodes; differences are of the same of both.",
            "",
            shown.to_markdown(index=False),
            "",
        ]
    )


if __name__ == "__main__":
    run_command(main, AblationConfig, "ablation")
