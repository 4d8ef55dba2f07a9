"""The tasks as an environment of LeRobot: `--env.type=guided_push --env.task=BlockPush-UR3-v0`."""

from dataclasses import dataclass, field

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGE, OBS_STATE

from envs import ENVIRONMENTS
from envs.arm.control import CONTROL_FREQUENCY
from envs.tasks import TASKS
from richmap.robots import SOURCE

OBSERVED = {
    "environment_state_agent_pos": ("agent_pos", "environment_state"),
    "pixels_agent_pos": ("agent_pos", "pixels"),
    "pixels": ("pixels",),
}
"""Kinds of observation, and what is in them; a state without its parts is not LeRobot's."""


@EnvConfig.register_subclass("guided_push")
@dataclass
class GuidedPushEnvConfig(EnvConfig):
    """Which task, which arm, and what binds it (`envs.arm.place_arm`)."""

    task: str | None = ENVIRONMENTS[SOURCE]
    """Gymnasium id, one of `envs.ENVIRONMENTS` or `envs.PRESS_BUTTONS_ENVIRONMENTS`; or `envs.BLOCK_PUSH` or
    `envs.PRESS_BUTTONS` with `robot`."""
    robot: str | None = None
    """Name of an arm that ships; None for the task's."""
    fps: int = CONTROL_FREQUENCY
    episode_length: int | None = None
    """Control steps after which an episode is cut off; None for the task's."""
    setting: str = "embodied"
    """`embodied` (joint limits and self-collision bind) or `original` (neither does)."""
    base: tuple[float, float, float] | None = None
    """Position of the arm's base, in [m]; None for the setting's."""
    branch: str | None = None
    """One that the arm's file states, or `found`; None for the setting's."""
    obs_type: str = "environment_state_agent_pos"
    """That, or `pixels_agent_pos` or `pixels` for a policy that sees pictures."""
    observation_width: int = 96
    """Of the picture that is observed, in pixels; likewise the next."""
    observation_height: int = 96
    visualization_width: int = 480
    """Of the videos, in pixels; likewise the next."""
    visualization_height: int = 360
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "environment_state": OBS_ENV_STATE,
            "pixels": OBS_IMAGE,
        }
    )

    def __post_init__(self) -> None:
        spaces = {f"envs.{task.name}.make:make": task.space for task in TASKS}
        spec = gymnasium.registry.get(self.gym_id.rpartition(":")[2])
        if spec is None or spec.entry_point not in spaces:
            raise ValueError(f"env.task={self.task} is none of our tasks, such as {ENVIRONMENTS[SOURCE]}.")
        space = spaces[spec.entry_point]
        if self.episode_length is None:
            self.episode_length = spec.max_episode_steps
        size = (self.observation_height, self.observation_width, 3)
        seen = {
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(space.state.width,)),
            "environment_state": PolicyFeature(type=FeatureType.ENV, shape=(space.environment.width,)),
            "pixels": PolicyFeature(type=FeatureType.VISUAL, shape=size),
        }
        if self.obs_type not in OBSERVED:
            raise ValueError(f"There is no env.obs_type {self.obs_type!r} for LeRobot. Types: {', '.join(OBSERVED)}")
        self.features[ACTION] = PolicyFeature(type=FeatureType.ACTION, shape=(space.action.width,))
        self.features |= {name: seen[name] for name in OBSERVED[self.obs_type]}

    @property
    def package_name(self) -> str:
        """Package whose import registers the task with Gymnasium."""
        return "envs"

    @property
    def gym_id(self) -> str:
        """Gymnasium's name of the task."""
        return str(self.task)

    @property
    def gym_kwargs(self) -> dict:
        """Arguments for `gymnasium.make`."""
        chosen = {} if self.robot is None else {"robot": self.robot}
        return chosen | {
            "setting": self.setting,
            "base": self.base,
            "branch": self.branch,
            "obs_type": self.obs_type,
            "render_mode": "rgb_array",
            "observation_width": self.observation_width,
            "observation_height": self.observation_height,
            "visualization_width": self.visualization_width,
            "visualization_height": self.visualization_height,
            "max_episode_steps": self.episode_length,
        }
