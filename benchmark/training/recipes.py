"""Recipes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmark.settings.recipe import USUAL
from benchmark.training.demonstration_recipe import CollectConfig


@dataclass(frozen=True)
class Recipe:
    """What policies learn from, and how."""

    demonstrations: CollectConfig
    policy: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that differ from its defaults."""


CLEAN = CollectConfig(share_noise=0, share_bursts=0, share_wide=0, share_crowded=0, output_dir="demonstrations/clean")


MADE_BY = {
    USUAL: Recipe(CollectConfig()),
    "clean": Recipe(CLEAN, {"displacement": 0.005, "n_obs_steps": 1}),
}
"""How the policies of each of `benchmark.settings.recipe.RECIPES` are made."""
