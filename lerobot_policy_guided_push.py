"""LeRobot finds this module by the distribution's name and so learns our policy, environments and processor steps."""

from envs.lerobot_environment import GuidedPushEnvConfig
from policies.configuration_guided_push import GuidedPushConfig
from policies.within_reach import KeepWithinReach, SeeArm

__all__ = ["GuidedPushConfig", "GuidedPushEnvConfig", "KeepWithinReach", "SeeArm"]
