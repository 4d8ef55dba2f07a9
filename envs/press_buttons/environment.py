"""Pressing buttons as a Gymnasium environment."""

import warnings
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Float, UInt8

from envs.arm.environment import ArmEnv, Observation
from envs.press_buttons.motion import counts, follow, keep_near, move
from envs.press_buttons.obstacles import draw_obstacles
from envs.press_buttons.scene import Scene, checked_scene, draw_scene
from envs.press_buttons.twin import ToolKinematics
from envs.press_buttons.workspace import DESCRIPTION, MAX_EPISODE_STEPS, MAX_STEP, MAX_TURN, TRAVEL
from richmap.motion.kinematics import forward
from richmap.task_spaces.press_buttons import BUTTONS, PRESS_BUTTONS_SPACE, ROD

with warnings.catch_warnings():
    warnings.simplefilter("ignore", SyntaxWarning)  # From robosuite's own text, when Python first compiles it.
    from envs.arm.simulation import make_simulation
    from envs.press_buttons.simulation import PressButtonsSimulation

FIRST, SECOND = 0.49, 0.51
"""Reward for the first button and for the second one; the shares of the score."""


class PressButtonsEnv(ArmEnv[PressButtonsSimulation]):
    """Press any two of four buttons, with the tip of a rod held by an arm. Ten control steps per second.

    Action, 6 numbers: step of the commanded tip in x, y and z, in [m], shortened to 0.03 m, and rotation vector of the
    commanded approach direction, in [rad], in the world, shortened to 0.15 rad. The rod's roll about its own axis is
    free: the arm takes what suits it. The command stays above z = .01 m. An arm to which commands come late
    (`PlacedArm.delay`) does what it was told so long ago; infos are of that command.

    A button is pressed once its cap is in by 12 mm while the measured tip is within 12 mm of its axis and the measured
    rod within 0.25 rad of it, looked at at the end of every control step; it stays pressed, and its cap comes back.

    A real arm is protected, so in the settings `embodied` and `best` the command stays within 8 cm and 0.4 rad of the
    tool, and an arm whose links touch each other, the rod, the table or a button for 0.1 s within a second is stopped;
    the rod may touch buttons and table, and nothing an obstacle (`PlacedArm.obstacles`). In `original` neither acts.

    State, 44 numbers: measured tip in [m] and approach direction (0-5), commanded ones (6-11), and of each button its
    place in [m], normal, whether it was pressed and whether it was pressed last (12-43). With
    `obs_type="environment_state_agent_pos"` it is split into `agent_pos` (0-11) and `environment_state` (the rest).
    `pixels` is a picture instead, (height, width, 3) uint8, and `pixels_agent_pos` a dict of both.

    Reward: 0.49 for the first button, 0.51 for the second, which ends the episode. Inside that last step one more
    second passes with the command held still, after which `info["success_at_end"]` tells whether the arm was not
    stopped in it; the observation is from before that second.

    It takes what `envs.arm.environment.ArmEnv` takes; `envs.press_buttons.make` makes the arm of a name.
    """

    task = "press-two-buttons"
    task_description = DESCRIPTION
    _max_episode_steps = MAX_EPISODE_STEPS
    space = PRESS_BUTTONS_SPACE
    built = ("_kinematics", "_rotation", "_work")

    def _action_space(self) -> spaces.Box:
        most = np.repeat([MAX_STEP, MAX_TURN], 3).astype(np.float32)
        return spaces.Box(-most, most, dtype=np.float32)

    def _bounds(self) -> tuple[Float[np.ndarray, "44"], Float[np.ndarray, "44"]]:
        """Places within 10 m, which nothing leaves; directions from -1 to 1, flags 0 or 1."""
        layout = PRESS_BUTTONS_SPACE.observation
        metres = np.array(layout.units) == "m"
        flags = np.array([name.endswith(("_pressed", "_last")) for name in layout.names])
        high = np.where(metres, 10, 1 + 1e-6 * ~flags).astype(np.float32)
        return np.where(flags, 0, -high).astype(np.float32), high

    def _make_simulation(self, visual: bool) -> PressButtonsSimulation:
        self._kinematics = ToolKinematics(self.arm)
        self._rotation, self._work = np.zeros((3, 3)), np.empty((4 * len(self._kinematics.start) + 16, 6))
        return make_simulation(PressButtonsSimulation, self.arm, self._kinematics.start, visual)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: the scene of this seed (`envs.press_buttons.scene.draw_scene`), or `options["scene"]`.

        Raises:
            ValueError: If there is another option, or the scene cannot be placed.
        """
        self._scene: Scene = self._begin(seed, options, checked_scene, draw_scene, draw_obstacles)
        self._joints = self._kinematics.start.copy()
        simulation = self._running
        simulation.place(self._scene, self._joints)
        self._command, self._direction = simulation.tip, simulation.approach
        self._underway = [(self._command.copy(), self._direction.copy())] * self._delay
        self._arrived, self._solved = self._flange(self._command, self._direction), simulation.flange_xyz
        self._pressed, self._missed = np.zeros(BUTTONS, dtype=bool), np.zeros(BUTTONS, dtype=bool)
        self._last = -1
        state, info = self._state(), self._info(0.0, 0.0)
        return self._observe(state), info

    def step(self, action: Float[np.ndarray, "6"]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the command, then let a tenth of a second pass."""
        action = np.array(action, dtype=np.float64)
        if action.shape != (6,) or not np.isfinite(action).all():
            raise ValueError(f"An action is six finite numbers, three in metres and three in radians. Got {action}")
        move(self._command, self._direction, action)
        self._advance()
        self._steps += 1
        before = int(self._pressed.sum())
        if not self._contact.stopped:
            self._look()
        now = int(self._pressed.sum())
        earned = FIRST * (before == 0 < now), SECOND * (before < 2 <= now)
        state, info = self._state(), self._info(*earned)
        if info["p2"]:
            info["success_at_end"] = self._stays_free()
        return self._observe(state), sum(earned), info["p2"] or self._contact.stopped, False, info

    def _draw(self, width: int, height: int) -> UInt8[np.ndarray, "height width 3"]:
        self._running.show(self._pressed)
        return super()._draw(width, height)

    def _advance(self) -> None:
        simulation, tool = self._running, self._kinematics.tool
        self._leash()
        self._underway.append((self._command.copy(), self._direction.copy()))
        tip, direction = self._underway.pop(0)
        self._arrived = self._flange(tip, direction)
        follow(tool, self._joints, tip, direction, self._rotation, self._work)
        self._solved, turned = np.empty(3), np.empty((3, 3))
        forward(tool.frames, self._joints, self._solved, turned)
        self._solved -= ROD * turned[:, 2]
        self._contact.begin_step()
        simulation.step(self._joints, self._contact)
        self._leash()

    def _leash(self) -> None:
        """Draw the command towards the tool as far as its leash wants."""
        if self.arm.protected:
            keep_near(self._command, self._direction, self._running.tip, self._running.approach)

    @staticmethod
    def _flange(tip: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return tip - ROD * direction

    def _look(self) -> None:
        """Which switches are closed now, and which caps are in without closing theirs."""
        simulation = self._running
        tip, pointing, travel = simulation.tip, simulation.approach, simulation.travel
        for i in np.flatnonzero(travel >= TRAVEL):
            if self._pressed[i]:
                continue
            if counts(travel[i], tip, pointing, self._scene.places[i], self._scene.normals[i]):
                self._pressed[i], self._last = True, i
            else:
                self._missed[i] = True

    def _state(self) -> Float[np.ndarray, "44"]:
        simulation, scene = self._running, self._scene
        last = np.arange(BUTTONS) == self._last
        buttons = np.column_stack([scene.places, scene.normals, self._pressed, last])
        parts = [simulation.tip, simulation.approach, self._command, self._direction, buttons.ravel()]
        return np.concatenate(parts).astype(np.float32)

    def _info(self, first: float, second: float) -> dict[str, Any]:
        simulation = self._running
        flange = simulation.flange_xyz
        pressed = int(self._pressed.sum())
        p1, p2 = pressed >= 1, pressed >= 2 and not self._contact.stopped
        return self._arm_info() | {
            "is_success": p2,
            "p1": p1,
            "p2": p2,
            "score": round(FIRST * p1 + SECOND * p2, 2),
            "reward_first": first,
            "reward_second": second,
            "pair": self._scene.pair,
            "places": self._scene.places.copy(),
            "normals": self._scene.normals.copy(),
            "tip": simulation.tip,
            "approach": simulation.approach,
            "tracking_error": float(np.linalg.norm(flange - self._arrived)),
            "ik_residual": float(np.linalg.norm(self._solved - self._arrived)),
            "pressed": self._pressed.copy(),
            "missed": self._missed.copy(),
            "travel": simulation.travel,
        }
