"""Episodes that are imagined side by side."""

import numpy as np
from jaxtyping import Float

from envs.arm.imagined_path import ImaginedPaths
from envs.arm.obstacles import Places
from envs.press_buttons.motion import Buttons, Pointing, advance_all, advance_ideal
from envs.press_buttons.twin import KinematicTwin, ToolKinematics
from richmap.motion.kinematics import forward
from richmap.task_spaces.press_buttons import BUTTONS, LAST, NORMAL, PLACE, PRESS_BUTTONS_SPACE, PRESSED, ROD

STATE = PRESS_BUTTONS_SPACE.state


class ImaginedPresses(ImaginedPaths):
    """Several imagined episodes, a step at a time; see `policies.episode_model.Imagined`.

    Attributes:
        state, environment: What is seen, in the task's layout.
    """

    def __init__(
        self,
        kinematics: ToolKinematics | None,
        twin: KinematicTwin | None,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 12"],
        environment: Float[np.ndarray, "n 32"],
        obstacles: Places | None = None,
    ) -> None:
        self._tool = None if kinematics is None else kinematics.tool
        self._twin, self._obstacles = twin, obstacles
        self.state, self.environment = np.array(state, dtype=float), np.array(environment, dtype=float)
        buttons = self.environment.reshape(len(joints), BUTTONS, -1)
        self._places, self._normals = buttons[..., PLACE].copy(), buttons[..., NORMAL].copy()
        self._pressed = buttons[..., PRESSED] > 0.5
        self._last = np.where(buttons[..., LAST].any(1), buttons[..., LAST].argmax(1), -1)
        self._joints, commanded = np.array(joints, dtype=float), self.state[:, STATE["commanded"]]
        self._command, self._direction = commanded[:, :3].copy(), commanded[:, 3:].copy()
        self._tip, self._approach = self._command, self._direction
        if self._tool is not None:
            self._tip, self._approach = self._command.copy(), self._direction.copy()
            turned = np.empty((3, 3))
            for q, tip, approach in zip(self._joints, self._tip, self._approach, strict=True):
                forward(self._tool.frames, q, tip, turned)
                approach[:] = turned[:, 2]
        super().__init__(self._now())
        self._counts = [self._pressed.sum(1)]
        self._free: dict[int, bool] = {}

    def step(self, actions: Float[np.ndarray, "n 6"]) -> None:
        """Let a control step pass in those that are going on."""
        tool, given = self._tool, np.asarray(actions, dtype=float)
        buttons = Buttons(self._places, self._normals, self._pressed)
        command, measured = Pointing(self._command, self._direction), Pointing(self._tip, self._approach)
        if tool is None:
            advance_ideal(command, buttons, self._last, given, self.going)
        else:
            advance_all(tool, self._joints, command, measured, buttons, self._last, given, self.going)
        self._counts.append(self._pressed.sum(1))
        self.state[:, STATE["tool"]] = np.hstack([self._tip, self._approach])
        self.state[:, STATE["commanded"]] = np.hstack([self._command, self._direction])
        seen = self.environment.reshape(len(self.state), BUTTONS, -1)
        seen[..., PRESSED] = self._pressed
        seen[..., LAST] = np.arange(BUTTONS) == self._last[:, None]
        self._went_on(self._now(), self._counts[-1] >= 2)

    def _now(self) -> Float[np.ndarray, "n numbers"]:
        """Tip, approach direction and joints."""
        return np.hstack([self._tip, self._approach, self._joints])

    def flange(self, row: int) -> tuple[Float[np.ndarray, "steps 3"], Float[np.ndarray, "steps 3"]]:
        """Positions of the flange, in [m], and approach directions of a row, from the beginning to the end."""
        way = self._way(row)
        return way[:, :3] - ROD * way[:, 3:6], way[:, 3:6]

    def is_free(self, row: int) -> bool:
        """Whether the arm of a row touches nothing on its way but, with the rod, what it presses."""
        if row not in self._free:
            self._free[row] = self._twin is None or self._is_free(self._twin, row)
        return self._free[row]

    def is_lost(self, row: int) -> bool:
        """Whether its arm has touched by now what stops it. The rod may touch any button."""
        return self._stopped(row) is not None

    def achieved(self, row: int) -> tuple[int, int]:
        """How many buttons are pressed in a row when its arm first touches what stops it, or at its end, and after how
        many steps that is. The rod may touch any button, as in the environment."""
        end = self._end(row)
        return int(self._counts[end][row]), end

    def _first_stop(self, row: int, joints: Float[np.ndarray, "n dof"]) -> int | None:
        """The rod may touch any button, links none."""
        if self._twin is None:
            return None
        scene, buttons = (self._places[row], self._normals[row]), tuple(range(BUTTONS))
        return self._twin.first_touch(*scene, joints, buttons, self._obstacles)

    def _is_free(self, twin: KinematicTwin, row: int) -> bool:
        pressed = tuple(np.flatnonzero(self._pressed[row]).tolist())
        way = self._way(row)[:, 6:]
        return not twin.touches(self._places[row], self._normals[row], way, pressed, self._obstacles)
