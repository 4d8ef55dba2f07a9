"""How far from the border of what an arm can hold, over the table; from the cache, made on first use."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.maps import SHIPPED
from benchmark.settings.map_config import MapConfig

if TYPE_CHECKING:
    from rich.console import Console

    from envs.arm.placed_arm import PlacedArm
    from richmap.similarity.signed_distance import SignedDistanceField

VERSION = 1
"""Raised by hand when the same arm gets another field."""
ROLLS = "feasible where the tool is rolled"
"""What sets the fields apart of arms that hold their tool rolled somewhere; before 27 November 2026 they could not."""


def distance_field(
    arm: "PlacedArm", of_map: MapConfig, _energy: object, _workers: int, console: "Console"
) -> tuple["SignedDistanceField", Path]:
    """Signed distance to the border of what the arm can hold in its branch (`SignedDistanceField`), by the arm alone.

    Returns:
        The field, in the world frame, and its file in the cache.
    """
    from envs.block_push.holding import BOX, CELL_SIZE, distance, held
    from envs.block_push.workspace import HEIGHT
    from richmap.cache import cached, made_from
    from richmap.similarity.signed_distance import SignedDistanceField

    inputs = {
        "field": "distance",
        "robot": arm.robot_fingerprint,
        **({"narrowed": arm.narrowed} if arm.narrowed else {}),
        "base": [x + 0.0 for x in arm.kinematic_base],  # No negative zero.
        "yaw": arm.yaw,
        "posture": [round(angle, 6) for angle in arm.posture],
        "bounds": arm.bounds,
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
        "box": BOX,
        "height": HEIGHT,
        "cell_size": CELL_SIZE,
    }
    key = made_from(inputs, VERSION)

    def make() -> SignedDistanceField:
        with console.status(f"Where {arm.robot} can hold its tool over the table"):
            table = held(arm)
            fingerprint = made_from({**inputs, ROLLS: True}, VERSION) if table.rolls else key
            return distance(table, {"target": arm.robot, "fingerprint": fingerprint})

    name, shipped = f"fields/distance-{arm.robot}-{key[:16]}.safetensors", None if of_map.rebuild else SHIPPED
    return cached(name, SignedDistanceField.load, make, shipped)
