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
    folder: str | None = None
    """Of the demonstrations; None for the usual one."""


CLEAN = CollectConfig(shares=["noise:0", "bursts:0", "wide:0", "crowded:0"])


POLICIES: Mapping[str, Mapping[str, Any]] = {
    "press_buttons": {"n_obs_steps": 1, "horizon": 8, "trunk_width": 256, "head_width": 192, "head_blocks": 3},
}
"""Fields of `GuidedPushConfig` that differ from its defaults, by task."""

MADE_BY = {
    USUAL: Recipe(CollectConfig()),
    "clean": Recipe(CLEAN, {"displacement": 0.005, "n_obs_steps": 1}, "demonstrations/block_push_clean"),
}
"""How the policies of each of `benchmark.settings.recipe.RECIPES` are made."""
