"""The block-push task as a Gymnasium environment."""

import math
import warnings
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Bool, Float

from envs.arm.environment import ArmEnv, Observation
from envs.arm.inverse_kinematics import Posture
from envs.arm.placed_arm import start_posture
from envs.block_push.obstacles import draw_obstacles
from envs.block_push.scene import Scene, checked_scene, draw_scene
from envs.block_push.success import both_placed, inside, rewards, score
from envs.block_push.workspace import DESCRIPTION, HEIGHT, LEASH, MAX_EPISODE_STEPS, MAX_STEP, POSES, WORKSPACE
from richmap.task_spaces.block_push import AT, BLOCK_PUSH_SPACE, BLOCKS, START, TARGETS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", SyntaxWarning)  # From robosuite's own text, when Python first compiles it.
    from envs.arm.simulation import make_simulation
    from envs.block_push.simulation import BlockPushSimulation

YAWS = [i for i, unit in enumerate(BLOCK_PUSH_SPACE.observation.units) if unit == "rad"]
"""Which numbers of the state are angles."""


class BlockPushEnv(ArmEnv[BlockPushSimulation]):
    """Push two blocks into two targets, one each, with a rod held by an arm. Ten control steps per second.

    Action, 2 numbers in [m]: step of the commanded effector in x and y, clipped to 0.1 each; the command adds
    up and stays in the box x .15 to .70, y -.50 to .50. An arm to which commands come late (`PlacedArm.delay`) does
    what it was told so long ago; infos are of that command, observations of the present one. The flange is kept at
    z = .06 with the tool upright, or as much higher as its tool is longer.

    For an arm whose file states a scale (`richmap.robots.robot_file`), a metre here is that many of its own.

    A real arm is protected, so in the settings `embodied` and `best` the command stays within 0.08 m of the flange, and
    an arm whose links touch each other, its tool or the table for 0.1 s within a second is stopped
    (`envs.arm.contact`): the episode ends, and the step in which it does earns nothing. In `original` neither acts. The
    same goes for links and tool that touch one of the arm's obstacles (`PlacedArm.obstacles`), if it stands among some.

    State, 16 numbers, xy in [m] in the world, yaw in [rad] modulo pi: block x, y, yaw (0-2); block2 (3-5);
    effector measured x, y (6-7) and commanded x, y (8-9); target x, y, yaw (10-12); target2 (13-15). With
    `obs_type="environment_state_agent_pos"` it is split into `agent_pos` (6-9) and `environment_state` (the
    rest). `pixels` is a picture instead, (height, width, 3) uint8, and `pixels_agent_pos` a dict of both.

    Reward: 0.49 for every first entry of a block into a target, 0.51 when both blocks are in different
    targets, which ends the episode. Inside that last step one more second passes with the command held still,
    after which `info["success_at_end"]` tells whether both are still in and the arm was not stopped; the observation
    is from before that second.

    It takes what `envs.arm.environment.ArmEnv` takes; `envs.block_push.make` makes the arm of a name.
    """

    task = "push-two-blocks"
    task_description = DESCRIPTION
    _max_episode_steps = MAX_EPISODE_STEPS
    space = BLOCK_PUSH_SPACE
    built = ("_kinematics", "_start")

    def _action_space(self) -> spaces.Box:
        return spaces.Box(-MAX_STEP, MAX_STEP, (BLOCK_PUSH_SPACE.action.width,), np.float32)

    def _bounds(self) -> tuple[Float[np.ndarray, "16"], Float[np.ndarray, "16"]]:
        """Positions within 10 m, which nothing leaves; yaw within [0, pi]."""
        width = BLOCK_PUSH_SPACE.observation.width
        low, high = np.full(width, -10, np.float32), np.full(width, 10, np.float32)
        low[YAWS], high[YAWS] = 0, np.pi
        return low, high

    def _make_simulation(self, visual: bool) -> BlockPushSimulation:
        self._kinematics = self.arm.kinematics()
        self._start = start_posture(self.arm, self._kinematics, POSES.start)
        return make_simulation(BlockPushSimulation, self.arm, self._start, visual)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: the scene of this seed (`envs.block_push.scene.draw_scene`), or `options["scene"]`.

        Raises:
            ValueError: If there is another option, or the scene cannot be placed.
        """
        scene = self._scene = self._begin(seed, options, checked_scene, draw_scene, draw_obstacles)
        self._targets = np.stack([scene.target, scene.target2])
        self._command = np.array(scene.effector, dtype=float)
        self._underway = [self._command.copy()] * self._delay
        self._arrived = self._command.copy()
        self._posture = self._posture_over(scene)
        self._running.place(scene, self._posture.joints)
        self._been_inside = np.zeros((2, 2), dtype=bool)
        state, info = self._state(), self._info((0.0, 0.0), self._inside())
        return self._observe(state), info

    def step(self, action: Float[np.ndarray, "2"]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the command, then let a tenth of a second pass."""
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (2,) or not np.isfinite(action).all():
            raise ValueError(f"An action is two finite numbers, in metres. Got {action}")
        step = np.clip(action, -MAX_STEP, MAX_STEP)
        self._command = np.clip(self._command + step, WORKSPACE[0], WORKSPACE[1])
        self._advance()
        self._steps += 1
        stopped = self._contact.stopped
        now = self._inside()
        earned = (0.0, 0.0) if stopped else rewards(self._been_inside, now)
        self._been_inside |= now & (not stopped)
        state, info = self._state(), self._info(earned, now)
        if info["p2"]:
            info["success_at_end"] = self._stays_free() and both_placed(self._inside())
        return self._observe(state), sum(earned), info["p2"] or stopped, False, info

    def _advance(self) -> None:
        self._command = self._leashed(self._command)
        self._underway.append(self._command)
        arrived = self._underway.pop(0)
        self._posture = self._kinematics.solve(np.array([*arrived, HEIGHT]), self._posture.joints)
        self._contact.begin_step()
        self._running.step(self._posture.joints, self._contact)
        self._command, self._arrived = self._leashed(self._command), self._leashed(arrived)

    def _leashed(self, command: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """A command, xy in [m], drawn towards the flange as far as its leash wants."""
        flange = self._running.flange_xyz[:2]
        ahead = command - flange
        distance = math.sqrt(ahead.dot(ahead))
        return flange + ahead * (LEASH / distance) if self.arm.protected and distance > LEASH else command

    def _inside(self) -> Bool[np.ndarray, "2 2"]:
        """Which block (row) is in which target (column)."""
        return inside(self._running.blocks_xyz[:, :2], self._targets[:, :2])

    def _posture_over(self, scene: Scene) -> Posture:
        """Joint angles over the scene's start, reached from the usual start in short steps: same branch."""
        way = np.linspace(START, scene.effector, 1 + int(np.ceil(np.linalg.norm(scene.effector - START) / 0.02)))
        posture = Posture(self._start, 0.0, 0.0)
        for point in way:
            posture = self._kinematics.solve(np.array([*point, HEIGHT]), posture.joints)
        return posture

    def _state(self) -> Float[np.ndarray, "16"]:
        simulation = self._running
        state = np.empty(BLOCK_PUSH_SPACE.observation.width)
        state[BLOCKS] = np.column_stack([simulation.blocks_xyz[:, :2], simulation.blocks_yaw]).ravel()
        state[AT["effector"]] = simulation.flange_xyz[:2]
        state[AT["commanded"]] = self._command
        state[TARGETS] = self._targets.ravel()
        state[YAWS] %= np.pi
        return state.astype(np.float32)

    def _info(self, earned: tuple[float, float], now: Bool[np.ndarray, "2 2"]) -> dict[str, Any]:
        simulation = self._running
        behind = simulation.flange_xyz[:2] - self._arrived
        p1, p2 = bool(self._been_inside.any()), both_placed(now) and not self._contact.stopped
        return self._arm_info() | {
            "is_success": p2,
            "p1": p1,
            "p2": p2,
            "score": score(p1, p2),
            "reward_entry": earned[0],
            "reward_both": earned[1],
            "mode": self._scene.mode,
            "tracking_error": math.sqrt(behind.dot(behind)),
            "ik_residual": self._posture.residual,
            "tool_tilt": simulation.tool_tilt,
            "block_positions": simulation.blocks_xyz,
            "block_tilt": simulation.blocks_tilt,
            "target_positions": self._targets[:, :2].copy(),
            "block_in_target": np.where(now.any(1), now.argmax(1), -1),
        }
