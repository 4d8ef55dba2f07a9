"""Where the obstacles of a scene are: beside the ways on which the scripted expert presses any two of the buttons."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool

from envs.arm.cuboid import first_of
from envs.arm.obstacles import AWAY, TRIED, Places, Surroundings, draw_places
from envs.press_buttons.scene import IN_TIME, PAIRS, draw_scene, source, source_twin
from envs.press_buttons.workspace import CUBOIDS
from richmap.task_spaces.press_buttons import ROD

SKIPPED = 4
"""Of a way's configurations one in so many is looked at first."""
OFF = 0.02
"""Obstacles are at least so far from wherever the source's arm goes, in [m]."""
OFF_BUTTONS = 0.12
"""Their middles keep so far from buttons, in [m]."""


@lru_cache(maxsize=4096)
def draw_obstacles(seed: int, count: int) -> Places:
    """The places of so many obstacles in the scene of a seed; alike for all arms."""
    scene, rng, twin = draw_scene(seed), np.random.default_rng([seed, 39]), source_twin()
    paths = [twin.path(scene.places, scene.normals, *pair, IN_TIME) for pair in PAIRS]
    joints = np.concatenate([path for path in paths if path is not None])
    surroundings = _source_among(count)

    def may_stand(places: Places) -> Bool[np.ndarray, " cuboids"]:
        off = np.linalg.norm(places[:, None, :3] - scene.places, axis=-1).min(1)
        places[off < OFF_BUTTONS, 2] = AWAY
        for part in (slice(None, None, SKIPPED), slice(None)):
            places[~surroundings.stay_clear(places, joints[part]), 2] = AWAY
        return places[:, 2] > AWAY

    places = draw_places(rng, first_of(CUBOIDS, count), twin.tips(joints[::SKIPPED])[:, :2], may_stand)
    places.flags.writeable = False
    return places


@lru_cache
def _source_among(count: int) -> Surroundings:
    """The source among so many obstacles, `TRIED` times over."""
    return Surroundings(source(), first_of(CUBOIDS, count) * TRIED, ROD, OFF)
