"""What the paper publishes, to be shown beside our own figures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """Success of nine models on an arm, as fractions: mean, least and most."""

    direct: tuple[float, float, float]
    guided: tuple[float, float, float] | None
    """None for the source arm. Which lambda it is, the paper does not say."""


TABLE_3 = {
    "xarm6": Published((0.9540, 0.9294, 0.9800), None),
    "ur3": Published((0.6464, 0.6282, 0.7188), (0.9134, 0.8784, 0.9596)),
    "ur5": Published((0.9515, 0.9286, 0.9898), (0.9460, 0.8988, 0.9898)),
    "ur10": Published((0.7596, 0.7470, 0.8274), (0.8272, 0.7764, 0.8678)),
}
"""RichMap, Table 3: "Success rates for policy transfer from xArm6 source to UR series robots over 9 models"."""
