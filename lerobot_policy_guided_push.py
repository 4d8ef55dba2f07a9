"""LeRobot finds this module by the distribution's name and so learns our policy and environments."""

from envs.block_push.lerobot_environment import GuidedPushEnvConfig
from policies.configuration_guided_push import GuidedPushConfig

__all__ = ["GuidedPushConfig", "GuidedPushEnvConfig"]
