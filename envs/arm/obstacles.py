"""Cuboids on and over the table that an arm is not to touch: what they are, and where a scene has them.

They stand beside the way of the source's tool, and out of its arm's way: what another arm has there may meet them.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from envs.arm.collision_bounds import tighten_bounds
from envs.arm.collision_model import arm_with_rod
from envs.arm.contact import ARM_BIT, SCENE_BIT
from envs.arm.cuboid import Cuboid
from envs.arm.placed_arm import PlacedArm

COLOUR = "0.95 0.65 0.15 0.55"
BESIDE = (0.05, 0.15)
"""As far beside a point of the tool's way its middle is drawn, in [m]."""
AWAY = -10.0
"""Height at which nothing is touched, in [m]."""
TRIED = 4
"""Places of each that are tried at once."""
CLOSE = 0.02
"""The nearest of cuboids that are so close, in [m], is found fastest by looking at all of them."""


type Places = Float[np.ndarray, "cuboids 4"]
"""Of cuboids: x, y, z of their middles, in [m] in the world, and their turns about the vertical, in [rad]."""


def names(count: int) -> list[str]:
    """Of the bodies of so many cuboids."""
    return [f"obstacle{i}" for i in range(count)]


def add_to(world: ET.Element, cuboids: Sequence[Cuboid]) -> None:
    """Put them into a model's text, as bodies that can be put anywhere (mocap); arms and loose things collide."""
    for name, cuboid in zip(names(len(cuboids)), cuboids, strict=True):
        geom = {
            "name": f"{name}_cuboid", "type": "box", "size": " ".join(map(str, cuboid.half)), "rgba": COLOUR,
            "contype": "0", "conaffinity": str(ARM_BIT | SCENE_BIT), "group": "1",
        }  # fmt: skip
        ET.SubElement(ET.SubElement(world, "body", name=name, mocap="true"), "geom", geom)


def put(data: mujoco.MjData, mocaps: Sequence[int], places: Places) -> None:
    """Put mocap bodies there."""
    half = places[:, 3] / 2
    data.mocap_pos[mocaps] = places[:, :3]
    data.mocap_quat[mocaps] = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])


class Surroundings:
    """Whether an arm and the rod that it holds come near to cuboids.

    Args:
        arm: The arm, as it stands.
        cuboids: Which.
        rod: Length of the rod, in [m].
        near: What counts as near, in [m].

    Attributes:
        model, data: The arm, the rod and the cuboids, as MuJoCo has them.
    """

    def __init__(self, arm: PlacedArm, cuboids: Sequence[Cuboid], rod: float, near: float) -> None:
        spec = arm_with_rod(arm, rod, meets=0)
        for name, cuboid in zip(names(len(cuboids)), cuboids, strict=True):
            box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": cuboid.half, "margin": near}
            spec.worldbody.add_body(name=name, mocap=True).add_geom(name=name, contype=0, conaffinity=ARM_BIT, **box)
        self.model = spec.compile()
        tighten_bounds(self.model)
        self.data = mujoco.MjData(self.model)
        self._number = {self.model.geom(name).id: i for i, name in enumerate(names(len(cuboids)))}
        self._near_to, self._cuboids = near, [*self._number]
        moves = self.model.body_weldid[self.model.geom_bodyid] > 0
        self._links = np.flatnonzero(moves & (self.model.geom_contype & ARM_BIT > 0))

    def is_near(self, places: Places, joints: Float[np.ndarray, "m dof"]) -> Bool[np.ndarray, " m"]:
        """In which of these configurations, in [rad], the arm is near to one of the cuboids."""
        put(self.data, range(len(places)), places)
        return np.array([bool(self._near(q)) for q in joints], dtype=bool)

    def stay_clear(self, places: Places, joints: Float[np.ndarray, "m dof"]) -> Bool[np.ndarray, " cuboids"]:
        """Which of the cuboids the arm is near to in none of these configurations, in [rad]."""
        put(self.data, range(len(places)), places)
        clear = places[:, 2] > AWAY
        for q in joints:
            for i in self._near(q):
                clear[i] = False
                self.data.mocap_pos[i, 2] = AWAY
            if not clear.any():
                break
        return clear

    def nearest(
        self, places: Places, joints: Float[np.ndarray, "m dof"]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m dof"]]:
        """Distance from the nearest cuboid in these configurations, in [m], and its slope along the joints; infinite
        and 0 where none is near."""
        put(self.data, range(len(places)), places)
        distance, slope = np.full(len(joints), np.inf), np.zeros(joints.shape)
        for k, q in enumerate(joints):
            if self._near_to > CLOSE:
                self.model.geom_margin[self._cuboids] = np.clip(self._no_farther_than(q), CLOSE, self._near_to)
            if self._near(q):
                near = np.argmin(self.data.contact.dist)
                distance[k], slope[k] = self.data.contact.dist[near], self._slope(self.data.contact[near])
        self.model.geom_margin[self._cuboids] = self._near_to
        return distance, slope

    def _no_farther_than(self, q: Float[np.ndarray, " dof"]) -> float:
        """How far the nearest cuboid is at most, in [m]: as the middles of the arm's shapes are from cuboids."""
        self._move_to(q)
        middles, axes = self.data.geom_xpos, self.data.geom_xmat[self._cuboids].reshape(-1, 3, 3)
        seen = np.einsum("lci,cij->lcj", middles[self._links, None] - middles[self._cuboids], axes)
        beyond = np.maximum(np.abs(seen) - self.model.geom_size[self._cuboids], 0.0)
        return float(np.sqrt((beyond**2).sum(-1)).min(initial=np.inf))

    def _slope(self, contact: mujoco.MjContact) -> Float[np.ndarray, " dof"]:
        """Of a contact's distance along the joints."""
        mujoco.mj_comPos(self.model, self.data)
        side = int(contact.geom[0] in self._number)  # Whose geom is the arm's; the normal points to that of side 1.
        away = (2 * side - 1) * contact.frame[:3]
        point, moves = contact.pos + contact.dist / 2 * away, np.empty((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, moves, None, point, self.model.geom_bodyid[contact.geom[side]])
        return away @ moves

    def _move_to(self, q: Float[np.ndarray, " dof"]) -> None:
        """Put the arm's links where a configuration, in [rad], has them."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)

    def _near(self, q: Float[np.ndarray, " dof"]) -> set[int]:
        """Numbers of the cuboids that the arm is near to."""
        data = self.data
        self._move_to(q)
        mujoco.mj_collision(self.model, data)
        return (
            {self._number[i] for i in data.contact.geom.ravel().tolist() if i in self._number} if data.ncon else set()
        )


def draw_places(
    rng: np.random.Generator,
    cuboids: Sequence[Cuboid],
    way: Float[np.ndarray, "k 2"],
    may_stand: Callable[[Places], Bool[np.ndarray, " cuboids"]],
) -> Places:
    """Places of cuboids beside a way.

    Args:
        rng: What is drawn from.
        cuboids: Which.
        way: Points of the way of the source's tool, xy in [m].
        may_stand: Says which of the cuboids, `TRIED` times one after another, may stand there.
    """
    found, count = np.full((len(cuboids), 4), np.nan), len(cuboids)
    low, high = np.array([each.heights or (each.half[2],) * 2 for each in cuboids] * TRIED).T
    while np.isnan(found).any():
        angle, yaw = rng.uniform(-np.pi, np.pi, (2, TRIED * count))
        aside = rng.uniform(*BESIDE, (TRIED * count, 1)) * np.column_stack([np.cos(angle), np.sin(angle)])
        places = np.column_stack([way[rng.integers(len(way), size=len(yaw))] + aside, rng.uniform(low, high), yaw])
        places[np.tile(~np.isnan(found[:, 0]), TRIED), 2] = AWAY
        for i in np.flatnonzero(may_stand(places)):
            if np.isnan(found[i % count, 0]):
                found[i % count] = places[i]
    return found
