"""A policy of two layers, as LeRobot wants it told; its weights are in `modeling_two_layer`."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig


@PreTrainedConfig.register_subclass("two_layer")
@dataclass
class TwoLayerConfig(PreTrainedConfig):
    """Sees state and environment state, one step of each."""

    hidden: int = 4
    push_to_hub: bool = False
    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None

    def get_optimizer_preset(self) -> None:
        """Nobody trains it."""

    def get_scheduler_preset(self) -> None:
        """Likewise."""

    def validate_features(self) -> None:
        """All are taken as they come."""
