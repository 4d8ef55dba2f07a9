"""Steps of LeRobot's processors that keep a policy's commands within what an arm can follow.

They come as a pair, because `lerobot-eval` tells no step when an episode begins: one in the pre-processor sees where
the arm is, and one in the post-processor shortens a command that would lead it to where it cannot follow.
"""

import json
import shutil
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from lerobot.processor import (
    ObservationProcessorStep,
    PolicyActionProcessorStep,
    ProcessorStepRegistry,
)
from lerobot.utils.constants import OBS_STATE, POLICY_POSTPROCESSOR_DEFAULT_NAME, POLICY_PREPROCESSOR_DEFAULT_NAME
from scipy.spatial.transform import Rotation

from policies.named_poses import JOINTS, KINDS, POSE, POSE_STEP, NamedNumbers
from richmap.paths.within_reach import Pose, ReachLimits
from richmap.robots.custom import custom_robot
from richmap.robots.robots import load_robot

SEES, KEEPS = "see_arm", "keep_within_reach"
"""Names of the two steps in a processor's file."""
BEYOND = 0.05
"""An arm may be seen as far as this, in [m], from where it was last within its limits."""

Joints = Float[np.ndarray, " dof"]


class _Seen(threading.local):
    """What the step in the pre-processor hands to the one in the post-processor. LeRobot calls them in turn, in one
    thread for each batch of environments, and has no other way from the one to the other."""

    def __init__(self) -> None:
        self.state: Float[np.ndarray, "batch n"] | None = None
        self.last: WeakKeyDictionary[Any, list[Joints | None]] = WeakKeyDictionary()


_SEEN = _Seen()


@ProcessorStepRegistry.register(SEES)
@dataclass(eq=False)
class SeeArm(ObservationProcessorStep):
    """Sees where the arm is, for `KeepWithinReach`, and changes nothing. It stands before any normalisation."""

    key: str = OBS_STATE
    """The observation that the arm's state is."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Keep the arm's state for the step that needs it.

        Raises:
            ValueError: If there is none in the observation.
        """
        if self.key not in observation:
            raise ValueError(f"{SEES}: there is no {self.key!r} in the observation. It has: {', '.join(observation)}.")
        state = torch.as_tensor(observation[self.key]).detach().to("cpu", torch.float64)
        _SEEN.state = np.atleast_2d(state.numpy())
        return observation

    def get_config(self) -> dict[str, Any]:
        """For the processor's file."""
        return asdict(self)

    def transform_features(self, features: Any) -> Any:
        """They stay as they are."""
        return features


@ProcessorStepRegistry.register(KEEPS)
@dataclass(eq=False)
class KeepWithinReach(PolicyActionProcessorStep):
    """Shortens commands to what the arm can follow: in its branch, within joint limits and speeds, without touching
    itself. A command that it can follow passes bit for bit. It stands after all normalisation is undone.

    Raises:
        ValueError: If commands are of another kind, or names do not say what is needed.
    """

    robot: str
    """Name of an arm that ships, or the path of a URDF, xacro or MJCF file with `links`."""
    commands: str
    """`pose`: where the flange is to be; `pose_step`: by how much it is to move; `joints`: where they are to be."""
    command_names: Sequence[str]
    """What each number of the action is. Of a pose: x, y, z in m, and qx, qy, qz, qw or the rotation vector wx, wy, wz
    in rad; of a step: x, y, z in m, and turn_x, turn_y, turn_z about the same axes in rad; or the names of the arm's
    joints, in rad. '' for a number that is something else, such as a gripper's, which passes as it is."""
    state_names: Sequence[str]
    """What each number of the arm's state is: joints, or a pose, likewise."""
    base: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
    """Where the arm's base stands in the frame of the poses: x, y, z in m, and its turn about z in rad."""
    position: Sequence[float] = (0.0, 0.0, 0.0)
    """Of the flange along the axes that no name says, in m."""
    orientation: Sequence[float] = (0.0, 1.0, 0.0, 0.0)
    """Of the flange where no name says it: qx, qy, qz, qw; the tool down, as it stands here."""
    home: Sequence[float] | None = None
    """Joints, in rad, near which an episode begins, where the state does not say them."""
    fps: float = 10.0
    """Commands per second."""
    speed: float = float(np.pi)
    """Of joints whose description states none, in rad/s."""
    free_roll: bool | None = None
    """Whether the roll about the tool does not matter; null for arms of fewer than six joints alone."""
    degrees: bool = False
    """Whether joints of commands and state are in degrees instead of rad."""
    scale: float = 1.0
    """How many metres of the arm's one metre of the poses is."""
    links: Sequence[str] | None = None
    """Base and end effector of an arm in a file."""

    def __post_init__(self) -> None:
        if self.commands not in KINDS:
            raise ValueError(
                f"{KEEPS}: commands={self.commands!r} cannot be kept within reach, as nothing says where they lead. "
                f"Kinds: {', '.join(KINDS)}."
            )
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ValueError(f"{KEEPS}: fps={self.fps} is no number above 0, of commands per second.")
        robot = self.limits.robot
        of_arm = f"{robot.name} has the joints {', '.join(robot.joints)}"
        self._command = NamedNumbers.of(f"{KEEPS}: command_names", self.command_names, robot, (self.commands,))
        self._state = NamedNumbers.of(f"{KEEPS}: state_names", self.state_names, robot, (JOINTS, POSE))
        if self.commands == JOINTS and self._state.kind != JOINTS:
            raise ValueError(f"{KEEPS}: where joints are commanded, state_names has to name them. {of_arm}.")
        if self.home is not None and len(self.home) != len(robot.joints):
            raise ValueError(f"{KEEPS}: home has {len(self.home)} angles, and {of_arm}.")

    @cached_property
    def limits(self) -> ReachLimits:
        """What the arm can follow."""
        robot = custom_robot(self.robot, *self.links) if self.links else load_robot(self.robot)
        return ReachLimits(robot.in_units_of(self.scale), 1 / self.fps, self.free_roll, self.speed)

    def action(self, action: torch.Tensor) -> torch.Tensor:
        """Commands that the arms can follow, of a batch (n, width) of them.

        Raises:
            ValueError: If the arms were not seen, or are fewer or more, or no configuration holds one where it is seen.
        """
        state = _SEEN.state
        if state is None:
            raise ValueError(f"{KEEPS}: no step {SEES} in the pre-processor has seen where the arm is. Add both steps.")
        widths = len(state), state.shape[1], len(action), action.shape[-1]
        if widths != (len(action), len(self.state_names), len(state), len(self.command_names)):
            raise ValueError(
                f"{KEEPS}: expected {len(self.state_names)} numbers of state and {len(self.command_names)} of action, "
                f"of as many arms. Got {tuple(state.shape)} and {tuple(action.shape)}."
            )
        if not np.isfinite(state).all():
            row, number = np.argwhere(~np.isfinite(state))[0]
            raise ValueError(f"{KEEPS}: arm {row} is seen at {state[row, number]} in {self.state_names[number]!r}.")
        last = _SEEN.last.get(self, [])
        if len(last) != len(action):
            last = [None] * len(action)
        numbers = action.detach().to("cpu", torch.float64).numpy()
        kept = [self._kept(*each) for each in zip(numbers, state, last, strict=True)]
        _SEEN.last[self] = [joints for _, joints in kept]
        new = action.clone()
        for row, (command, _) in enumerate(kept):
            if command is not None:
                new[row] = torch.as_tensor(command).to(action)
        return new

    def get_config(self) -> dict[str, Any]:
        """For the processor's file."""
        return json.loads(json.dumps(asdict(self)))

    def reset(self) -> None:
        """Forget where the arms were."""
        _SEEN.last.pop(self, None)

    def transform_features(self, features: Any) -> Any:
        """They stay as they are."""
        return features

    def _kept(
        self, command: Float[np.ndarray, " n"], state: Float[np.ndarray, " k"], last: Joints | None
    ) -> tuple[Float[np.ndarray, " n"] | None, Joints]:
        """What may be commanded, None if that is what is, and where the arm is, in [rad]."""
        names, limits = self.limits.robot.joints, self.limits
        joints, start = self._where(state, last)
        if self.commands == JOINTS:
            wanted = self._unit * self._command.read(command, names)
            kept = limits.joints_towards(joints, wanted)
            same = np.array_equal(kept, wanted)
            return None if same else self._command.write(command, names, kept / self._unit), joints
        stepwise = self.commands == POSE_STEP
        goal = self._command.stepped(command, start) if stepwise else self._command.pose(command, self._rest)
        share = limits.towards(joints, self._from_base(start), self._from_base(goal))
        if share == 1:
            return None, joints
        if stepwise:
            return self._command.shortened(command, share), joints
        positions, rotations = start.way_to(goal, np.array([share]))
        return self._command.with_pose(command, Pose(positions[0], rotations[0])), joints

    def _where(self, state: Float[np.ndarray, " k"], last: Joints | None) -> tuple[Joints, Pose]:
        """Where an arm is: its joints, in [rad], and its flange in the frame of the poses."""
        if self._state.kind == JOINTS:
            joints = self._unit * self._state.read(state, self.limits.robot.joints)
            return joints, self._to_world(self.limits.pose_of(joints))
        pose = self._state.pose(state, self._rest)
        home = None if self.home is None else np.array(self.home)
        found = self.limits.configuration(self._from_base(pose), last, home)
        if found is not None:
            return found, pose
        held = None if last is None else self._to_world(self.limits.pose_of(last))
        if last is None or held is None or np.linalg.norm(held.position - pose.position) > BEYOND:
            raise ValueError(
                f"{KEEPS}: no configuration of {self.limits.robot.name} within its limits holds the flange where it is "
                f"seen, at {pose.position.round(3).tolist()} m. Look at base, position and orientation."
            )
        return last, held  # Seen a little beyond what it reaches.

    @property
    def _unit(self) -> float:
        """Of joints in commands and state, in [rad]."""
        return np.pi / 180 if self.degrees else 1.0

    @cached_property
    def _rest(self) -> Pose:
        return Pose(np.array(self.position, dtype=float), Rotation.from_quat(self.orientation).as_matrix())

    @cached_property
    def _turn(self) -> Float[np.ndarray, "3 3"]:
        return Rotation.from_euler("z", self.base[3]).as_matrix()

    def _from_base(self, pose: Pose) -> Pose:
        return Pose((pose.position - np.array(self.base[:3])) @ self._turn, self._turn.T @ pose.rotation)

    def _to_world(self, pose: Pose) -> Pose:
        return Pose(self._turn @ pose.position + np.array(self.base[:3]), self._turn @ pose.rotation)


def keep_checkpoint_within_reach(checkpoint: Path | str, folder: Path | str, step: KeepWithinReach) -> None:
    """Copy a checkpoint, of any type of policy, and add both steps to its processors.

    Args:
        checkpoint: Its folder.
        folder: Where the copy goes; files of these names that are there are replaced.
        step: What keeps its commands within reach.

    Raises:
        FileNotFoundError: If there is no checkpoint, or it has no processors.
    """
    shutil.copytree(checkpoint, folder, dirs_exist_ok=True)
    _edit_steps(Path(folder), POLICY_PREPROCESSOR_DEFAULT_NAME, [_entry(SEES, SeeArm())], [])
    _edit_steps(Path(folder), POLICY_POSTPROCESSOR_DEFAULT_NAME, [], [_entry(KEEPS, step)])


def _edit_steps(folder: Path, name: str, first: list[dict[str, Any]], last: list[dict[str, Any]]) -> None:
    """Put steps before and after those of a processor, in place of earlier ones of ours."""
    file = folder / f"{name}.json"
    said = json.loads(file.read_text())
    steps = [step for step in said["steps"] if step.get("registry_name") not in (SEES, KEEPS)]
    file.write_text(json.dumps(said | {"steps": [*first, *steps, *last]}, indent=2))


def _entry(name: str, step: SeeArm | KeepWithinReach) -> dict[str, Any]:
    return {"registry_name": name, "config": step.get_config()}
