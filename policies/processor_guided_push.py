"""Pre- and post-processors of the guided push policy: LeRobot's own, with nothing to normalise."""

from typing import Any

from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors

from policies.configuration_guided_push import GuidedPushConfig


def make_lerobot_policy_guided_push_pre_post_processors(
    config: GuidedPushConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Batch dimension and device only: the model scales by `GuidedPushConfig.action_unit`."""
    del dataset_stats  # A model whose unit came from the data would mean another lambda with every dataset.
    return make_default_pre_post_processors(config, None)
