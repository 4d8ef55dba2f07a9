"""What environments of all tasks share: observations, pictures, copies, closing."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from jaxtyping import Float, UInt8

from envs.arm.contact import ContactTime
from envs.arm.control import CONTROL_FREQUENCY
from envs.arm.place_arm import arm_or_named
from envs.arm.placed_arm import PlacedArm
from envs.arm.renderer import HEIGHT as PICTURE_HEIGHT
from envs.arm.renderer import WIDTH as PICTURE_WIDTH
from envs.arm.renderer import Renderer, check_size
from envs.arm.task_poses import TaskPoses
from richmap.task_spaces.task_space import TaskSpace

with warnings.catch_warnings():
    warnings.simplefilter("ignore", SyntaxWarning)  # From robosuite's own text, when Python first compiles it.
    from envs.arm.simulation import TIMESTEP, ArmSimulation

HOLD = 1.0
"""How long the command is held still after success before it is judged again, in [s]."""
OBS_TYPES = ("state", "environment_state_agent_pos", "pixels", "pixels_agent_pos")
"""What an observation may be."""
SEEN = ("obs_type", "render_mode") + tuple(
    f"{kind}_{side}" for kind in ("observation", "visualization") for side in ("width", "height")
)
"""Arguments of an environment that say what is seen of it, and not what the arm is."""
LEROBOT_BEGINS = "lerobot_new_rollout"
"""An option that `lerobot-eval` gives; it changes nothing here."""


def given_scene(options: Any) -> Any:
    """The option `scene` of a reset; None if it is not given.

    Raises:
        ValueError: If there is another option, or they are no dict.
    """
    options = {} if options is None else options
    if not isinstance(options, dict):
        raise ValueError(f"Options are a dict, such as {{'scene': scene}}. Got {options!r}")
    if unknown := [*map(repr, options.keys() - {"scene", LEROBOT_BEGINS})]:
        raise ValueError(f"There is no option {', '.join(unknown)}. Options: scene")
    return options.get("scene")


def on_arm[Env: "ArmEnv"](kind: type[Env], poses: TaskPoses, robot: str, arm: PlacedArm | None, given: Any) -> Env:
    """An environment on an arm, or on the one of a name, placed as is given.

    Args:
        kind: Of environment.
        poses: What its task asks of an arm.
        robot: Name of an arm that ships.
        arm: The arm itself instead.
        given: A dict of what `ArmEnv` takes besides the arm, and of what `envs.arm.place_arm.place_arm` takes.

    Raises:
        ValueError: If one of these cannot be.
    """
    choices = {name: value for name, value in given.items() if name not in SEEN}
    return kind(arm_or_named(arm, robot, poses, choices), **{name: given[name] for name in SEEN if name in given})


Observation = Float[np.ndarray, " numbers"] | UInt8[np.ndarray, "height width 3"] | dict[str, np.ndarray]


class ArmEnv[Simulation: ArmSimulation](gymnasium.Env, ABC):
    """An environment of a task that an arm does; what the task is a subclass says.

    A copy, or one that went through pickle, goes on as the original would, to the last bit.

    Args:
        arm: The arm, as it stands.
        obs_type: One of `OBS_TYPES`.
        render_mode: None or `rgb_array`.
        observation_width: Of the picture that is observed, in pixels.
        observation_height: Likewise.
        visualization_width: Of the picture that `render` gives, in pixels.
        visualization_height: Likewise.

    Raises:
        ValueError: If one of these cannot be.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_FREQUENCY}
    space: ClassVar[TaskSpace]
    """Of the task."""
    built: ClassVar[tuple[str, ...]]
    """Attributes that `_make_simulation` sets, which are made anew in a copy."""
    _scene: Any
    """Of the episode; it has `obstacles`."""
    _arrived: np.ndarray
    """Where the flange is told to be now, in [m]."""

    def __init__(
        self,
        arm: PlacedArm,
        obs_type: str = "state",
        render_mode: str | None = None,
        observation_width: int = 96,
        observation_height: int = 96,
        visualization_width: int = PICTURE_WIDTH,
        visualization_height: int = PICTURE_HEIGHT,
    ) -> None:
        if obs_type not in OBS_TYPES:
            raise ValueError(f"There is no obs_type {obs_type!r}. Types: {', '.join(OBS_TYPES)}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"There is no render_mode {render_mode!r}. Modes: None, rgb_array")
        check_size("observation", observation_width, observation_height)
        check_size("visualization", visualization_width, visualization_height)
        self.arm = arm
        self.obs_type, self.render_mode = obs_type, render_mode
        self._seen, self._shown = (observation_width, observation_height), (visualization_width, visualization_height)
        self.action_space = self._action_space()
        self.observation_space = self._observation_space()
        self._lower, self._upper = arm.joint_range
        self._delay = round(arm.delay * CONTROL_FREQUENCY)
        self._contact = ContactTime(arm.protected, TIMESTEP)
        self._build()

    @abstractmethod
    def _action_space(self) -> spaces.Box:
        """Of a step."""

    @abstractmethod
    def _bounds(self) -> tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, " numbers"]]:
        """Least and greatest numbers of the state."""

    @abstractmethod
    def _make_simulation(self, visual: bool) -> Simulation:
        """The simulation, with meshes to be seen or without; sets what `built` names."""

    @abstractmethod
    def _advance(self) -> None:
        """Let a control step pass."""

    def _begin(
        self,
        seed: int | None,
        options: Any,
        checked: Callable[[Any, int], Any],
        draw: Callable[[int], Any],
        draw_obstacles: Callable[[int, int], Any],
    ) -> Any:
        """The scene of the episode that begins: `options["scene"]`, checked, or that of the seed, with the arm's
        obstacles."""
        scene = given_scene(options)
        given = None if scene is None else checked(scene, self.arm.obstacles)
        super().reset(seed=seed)
        self._contact.reset()
        self._steps = 0
        if given is not None:
            return given
        seed = int(self.np_random.integers(2**31)) if seed is None else seed
        drawn = draw(seed)
        return replace(drawn, obstacles=draw_obstacles(seed, self.arm.obstacles)) if self.arm.obstacles else drawn

    def _arm_info(self) -> dict[str, Any]:
        """What infos of all tasks say of the arm, what it touched and the time."""
        joints, touched = self._running.joint_angles, self._contact.touched
        return {
            "success_at_end": False,
            "step": self._steps,
            "commanded": self._arrived.copy(),
            "flange": self._running.flange_xyz,
            "base": np.array(self.arm.base),
            "joint_limits": self.arm.joint_limits,
            "joint_limit_margin": float(np.minimum(joints - self._lower, self._upper - joints).min()),
            "self_contact": touched.itself,
            "table_contact": touched.table,
            "obstacle_contact": touched.obstacle,
            "obstacles": self._scene.obstacles.copy(),
            "stopped": self._contact.stopped,
        }

    def _build(self) -> None:
        """Make what is not copied: kinematics, simulation, and no renderer yet."""
        visual = self.render_mode is not None or self._observes_pixels
        self._simulation: Simulation | None = self._make_simulation(visual)
        self._renderer: Renderer | None = None

    def __getstate__(self) -> dict[str, Any]:
        built = ("_simulation", "_renderer", *self.built)
        data = None if self._simulation is None else self._simulation.mj_data
        return {name: value for name, value in self.__dict__.items() if name not in built} | {"_data": data}

    def __setstate__(self, state: dict[str, Any]) -> None:
        state = {**state}
        data = state.pop("_data")
        self.__dict__.update(state)
        self._build()
        if data is None:
            self.close()
        else:
            model, own = self.physics
            mujoco.mj_copyData(own, model, data)

    def render(self) -> np.ndarray | None:
        """A picture, (height, width, 3) uint8, if `render_mode` is `rgb_array`."""
        return None if self.render_mode is None else self._draw(*self._shown)

    def _draw(self, width: int, height: int) -> UInt8[np.ndarray, "height width 3"]:
        simulation = self._running
        if self._renderer is None:
            wanted = [self._seen] * self._observes_pixels + [self._shown] * (self.render_mode is not None)
            self._renderer = Renderer(simulation.mj_model, *map(max, zip(*wanted, strict=True)))
        return self._renderer.draw(simulation.mj_data, width, height)

    def close(self) -> None:
        """Give memory back, of graphics and of the simulation; there is nothing to reset after that."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    @property
    def physics(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """MuJoCo's model and its present state."""
        return self._running.mj_model, self._running.mj_data

    @property
    def _running(self) -> Simulation:
        """The simulation.

        Raises:
            gymnasium.error.ClosedEnvironmentError: If the environment was closed.
        """
        if self._simulation is None:
            raise gymnasium.error.ClosedEnvironmentError("The environment was closed. Make another one.")
        return self._simulation

    @property
    def _observes_pixels(self) -> bool:
        return self.obs_type.startswith("pixels")

    def _stays_free(self) -> bool:
        """Whether the arm is not stopped while the command is held still after success."""
        for _ in range(round(HOLD * CONTROL_FREQUENCY)):
            self._advance()
            if self._contact.stopped:
                return False
        return True

    def _observe(self, state: Float[np.ndarray, " numbers"]) -> Observation:
        if self.obs_type == "state":
            return state
        if self.obs_type == "pixels":
            return self._draw(*self._seen)
        agent, environment = self.space.split(state)
        if self.obs_type == "pixels_agent_pos":
            return {"pixels": self._draw(*self._seen), "agent_pos": agent}
        return {"agent_pos": agent, "environment_state": environment}

    def _observation_space(self) -> spaces.Space:
        low, high = self._bounds()
        if self.obs_type == "state":
            return spaces.Box(low, high)
        width, height = self._seen
        pixels = spaces.Box(0, 255, (height, width, 3), np.uint8)
        if self.obs_type == "pixels":
            return pixels
        agent, environment = map(spaces.Box, self.space.split(low), self.space.split(high))
        if self.obs_type == "pixels_agent_pos":
            return spaces.Dict(pixels=pixels, agent_pos=agent)
        return spaces.Dict(agent_pos=agent, environment_state=environment)
