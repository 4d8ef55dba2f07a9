"""Video."""

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from richmap.outputs import replacing

if TYPE_CHECKING:
    import gymnasium

    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.rollout import Rollout


def record(rollout: "Rollout", seed: int, file: Path) -> "Episode":
    """Play one episode and write it as a moving picture, of the kind of the file's ending, at twice its speed."""
    import imageio.v3 as imageio

    from benchmark.rollouts.rollout import alone

    frames, shown = [], cycle([True, False])

    def watch(env: "gymnasium.Env") -> None:
        if next(shown):
            image: Any = env.render()
            frames.append(image[::2, ::2])

    episode = alone(rollout, seed, watch)
    with replacing(file) as path:
        imageio.imwrite(path, frames, duration=1000 / rollout.task.control_frequency, loop=0)
    return episode
