"""How far the xArm6 is behind its command in its own demonstrations, which a policy can be shown in place of another
arm's."""

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from jaxtyping import Float

from envs.block_push.workspace import WORKSPACE
from richmap.task_spaces.block_push import AT, BLOCK_PUSH_SPACE

MIDDLE = WORKSPACE.mean(axis=0)
"""Of the table, where commands are told from, xy in [m]."""


@dataclass(frozen=True)
class Response:
    """The measured effector less the commanded one, xy in [m], as a linear function of the command and its last step.

    Attributes:
        weights: A row for each of: 1, the command from `MIDDLE` (2), its last step (2), in [m]; columns are x and y.
    """

    weights: tuple[tuple[float, float], ...]

    @classmethod
    def fitted(cls, state: Float[np.ndarray, "n 4"], episode: np.ndarray) -> tuple["Response", float]:
        """By least squares, on successive frames; and the root mean square of the distance that it leaves, in [m].

        Args:
            state: Measured and commanded effector, as `BLOCK_PUSH_SPACE.state` has them, in [m].
            episode: Of each frame.
        """
        measured, commanded = (state[:, BLOCK_PUSH_SPACE.state[name]] for name in ("effector", "commanded"))
        follows = np.flatnonzero(episode[1:] == episode[:-1]) + 1
        seen = _inputs(commanded[follows], commanded[follows] - commanded[follows - 1])
        behind = (measured - commanded)[follows]
        weights, *_ = np.linalg.lstsq(seen, behind)
        left = np.sqrt(((behind - seen @ weights) ** 2).sum(axis=1).mean())
        return cls(tuple((float(x), float(y)) for x, y in weights)), float(left)

    @classmethod
    def of_demonstrations(cls, folder: Path) -> tuple["Response", float]:
        """That of a data set of demonstrations."""
        import pandas as pd

        frames = pd.read_parquet(folder / "data", columns=["observation.state", "episode_index"])
        state = np.stack(frames["observation.state"].to_list()).astype(np.float64)
        return cls.fitted(state, frames["episode_index"].to_numpy())

    @property
    def text(self) -> str:
        """It in words."""
        at_rest, (x, y) = 1000 * np.array(self.weights[0]), np.diag(self.weights[3:])
        return (
            f"The effector is behind its command by {-x:.3f} and {-y:.3f} of the last step along x and y, and at rest "
            f"in the middle of the table it is ({at_rest[0]:+.2f}, {at_rest[1]:+.2f}) mm beside it."
        )

    def behind(self, commanded: Float[np.ndarray, "2"], step: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """The measured effector less the commanded one, in [m], after a step of the command."""
        return _inputs(commanded[None], step[None])[0] @ np.array(self.weights)


class ShowsResponse(gymnasium.Wrapper):
    """Shows the effector where it would be behind the command by a response; the simulation goes on as it does."""

    def __init__(self, env: gymnasium.Env, response: Response) -> None:
        super().__init__(env)
        self._response = response

    def reset(self, **options):
        """Start an episode; the command has made no step."""
        state, info = self.env.reset(**options)
        self._commanded = state[AT["commanded"]].astype(np.float64)
        return self._shown(state), info

    def step(self, action):
        """See the environment."""
        state, *rest = self.env.step(action)
        return (self._shown(state), *rest)

    def _shown(self, state: Float[np.ndarray, "16"]) -> Float[np.ndarray, "16"]:
        commanded, shown = state[AT["commanded"]].astype(np.float64), state.copy()
        shown[AT["effector"]] = commanded + self._response.behind(commanded, commanded - self._commanded)
        self._commanded = commanded
        return shown


def _inputs(commanded: Float[np.ndarray, "n 2"], step: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 5"]:
    return np.column_stack([np.ones(len(commanded)), commanded - MIDDLE, step])
