"""Video."""

from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from richmap.outputs import replacing, writing

if TYPE_CHECKING:
    import gymnasium

    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.rollout import Rollout


def record(rollout: "Rollout", seed: int, file: Path, caption: "Callable[[Episode], str] | None" = None) -> "Episode":
    """Play one episode and write it as a moving picture, of the kind of the file's ending, at twice its speed.

    Args:
        rollout: What is rolled out.
        seed: Of the episode.
        file: Where it goes.
        caption: What stands under the picture, which then has its full size and else half.
    """

    frames, shown, every = [], cycle([True, False]), 1 if caption else 2

    def watch(env: "gymnasium.Env") -> None:
        if next(shown):
            image: Any = env.render()
            frames.append(image[::every, ::every])

    (episode,) = rollout.play([seed], watch)
    write_film(file, frames, rollout.task.control_frequency, caption(episode) if caption else "")
    return episode


def write_film(file: Path, frames: "Sequence[np.ndarray]", frames_per_second: float, caption: str = "") -> None:
    """Write pictures as a moving one, with a caption under it."""
    import imageio.v3 as imageio

    if caption:
        strip = _written(caption, frames[0].shape[1])
        frames = [np.vstack([frame, strip]) for frame in frames]
    small: Any = {"quality": 50, "method": 6, "minimize_size": True}  # A third of WebP's usual size.
    film = imageio.imwrite("<bytes>", frames, extension=file.suffix, duration=1000 / frames_per_second, loop=0, **small)
    with replacing(file) as path, writing(path):
        path.write_bytes(film)


def _written(text: str, width: int) -> np.ndarray:
    """A text in dark letters, (height, width, 3) uint8, in as many lines as it needs."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        lines = [*lines[:-1], longer] if font.getlength(longer) <= width - 12 else [*lines, word]
    strip = Image.new("RGB", (width, 18 * len(lines) + 6), "white")
    ImageDraw.Draw(strip).multiline_text((6, 3), "\n".join(lines), "black", font)
    return np.asarray(strip)
