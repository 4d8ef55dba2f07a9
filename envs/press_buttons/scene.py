"""Where the buttons are when an episode starts."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from envs.arm.cuboid import checked_places
from envs.press_buttons.workspace import POSES, START
from richmap.robots import SOURCE
from richmap.task_spaces.press_buttons import BUTTONS

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm
    from envs.press_buttons.twin import KinematicTwin

RADIUS, AZIMUTH, HEIGHT = (0.3, 0.6), np.radians(75), (0.1, 0.45)
"""Buttons stand at such a distance from the z axis, in [m], within so much of the x axis to either side, in [rad], and
as high, in [m]; all evenly."""
LEAST_COSINE = np.cos(np.radians(100))
"""Of the tilt of their normals from the vertical, evenly drawn from this to 1."""
APART = 0.1
"""Between places of buttons, in [m]; so far keeps each from the line along which another is pressed, and from the rod
at the start."""
LINE = 0.3
"""Length of these lines from the face outwards, in [m]."""
IN_TIME = 110
"""Control steps in which the source has to have pressed two."""
FARTHEST = 3.0
"""Of buttons of one's own from the origin, in [m]."""
PAIRS = tuple(permutations(range(BUTTONS), 2))
"""Two buttons in an order: all twelve."""


@dataclass(frozen=True)
class Scene:
    """Four buttons, and which two of them the scripted oracle presses."""

    places: Float[np.ndarray, "4 3"]
    """Middle of each cap's face at rest, in [m] in the world."""
    normals: Float[np.ndarray, "4 3"]
    """Unit vectors out of these faces."""
    pair: tuple[int, int]
    """Which button the oracle presses first, and which then, from 0 on."""
    obstacles: Float[np.ndarray, "n 4"] = field(default_factory=lambda: np.empty((0, 4)))
    """Where the obstacles of the arm (`PlacedArm.obstacles`) are, as `envs.arm.obstacles.Places` has it."""


@lru_cache(maxsize=4096)
def draw_scene(seed: int) -> Scene:
    """The scene of a seed: buttons are drawn anew until they are apart and the source can press any two of them.

    Alike for all arms; the source stands at the origin, in its usual setting.
    """
    rng, twin = np.random.default_rng([seed, 38]), source_twin()
    while True:
        places, normals = draw_buttons(rng)
        if are_apart(places, normals) and can_press_any(twin, places, normals):
            for values in (places, normals):
                values.flags.writeable = False
            return Scene(places, normals, PAIRS[rng.integers(len(PAIRS))])


def draw_buttons(rng: np.random.Generator) -> tuple[Float[np.ndarray, "4 3"], Float[np.ndarray, "4 3"]]:
    """Places, in [m], and normals of four buttons, whether they can be pressed or not."""
    radius, azimuth = rng.uniform(*RADIUS, BUTTONS), rng.uniform(-AZIMUTH, AZIMUTH, BUTTONS)
    height, cosine = rng.uniform(*HEIGHT, BUTTONS), rng.uniform(LEAST_COSINE, 1, BUTTONS)
    about, sine = rng.uniform(-np.pi, np.pi, BUTTONS), np.sqrt(1 - cosine**2)
    places = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    return places, np.column_stack([sine * np.cos(about), sine * np.sin(about), cosine])


def are_apart(places: Float[np.ndarray, "4 3"], normals: Float[np.ndarray, "4 3"]) -> bool:
    """Whether each button is `APART` from the line along which each other one is pressed, and from the rod at the
    start."""
    along = np.linspace(0, LINE, 13)[:, None]
    lines = [place + along * normal for place, normal in zip(places, normals, strict=True)]
    lines.append(np.array(START) + along * np.array([0.0, 0.0, 1.0]))
    return all(
        i == j or np.linalg.norm(line - place, axis=1).min() >= APART
        for i, line in enumerate(lines)
        for j, place in enumerate(places)
    )


def can_press_any(twin: "KinematicTwin", places: Float[np.ndarray, "4 3"], normals: Float[np.ndarray, "4 3"]) -> bool:
    """Whether an arm presses any two buttons in either order, in time and touching nothing else."""
    paths = []
    for pair in PAIRS:
        joints = twin.path(places, normals, *pair, IN_TIME)
        if joints is None:
            return False
        paths.append((pair, joints))
    # A few configurations of each path first: nearly all that touch something do so in several.
    return not any(
        twin.touches(places, normals, joints[part], pair)
        for part in (slice(3, None, 5), slice(None))
        for pair, joints in paths
    )


def checked_scene(scene: Any, obstacles: int = 0) -> Scene:
    """A scene of one's own, if it can be placed, with so many obstacles.

    Raises:
        ValueError: If it is no scene, or something of it is not where it can be.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"A scene is an envs.press_buttons.scene.Scene. Got {type(scene).__name__}")
    placed: dict[str, Any] = {}
    for name in ("places", "normals"):
        try:
            placed[name] = np.asarray(getattr(scene, name), dtype=float)
        except (TypeError, ValueError):
            placed[name] = np.empty(0)
        if placed[name].shape != (BUTTONS, 3) or not np.isfinite(placed[name]).all():
            raise ValueError(f"The scene's {name} are {BUTTONS} times 3 finite numbers. Got {getattr(scene, name)!r}")
    if np.abs(placed["places"]).max() > FARTHEST:
        raise ValueError(f"The scene's places lie within {FARTHEST} m of the origin. Got {scene.places!r}")
    if np.abs(np.linalg.norm(placed["normals"], axis=1) - 1).max() > 1e-6:
        raise ValueError(f"The scene's normals are unit vectors. Got {scene.normals!r}")
    if scene.pair not in PAIRS:
        raise ValueError(f"The scene's pair is two different buttons from 0 to {BUTTONS - 1}. Got {scene.pair!r}")
    return replace(scene, obstacles=checked_places(scene.obstacles, obstacles), **placed)


@lru_cache
def source_twin() -> "KinematicTwin":
    """The source's twin, once per process."""
    from envs.press_buttons.twin import KinematicTwin

    return KinematicTwin(source())


@lru_cache
def source() -> "PlacedArm":
    """The source, as it stands."""
    from envs.arm.place_arm import place_arm

    return place_arm(SOURCE, POSES)
