"""Any other arm: a URDF or MJCF file with base and flange named, checked for what a map needs."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from richmap.robots.reading import read_arm
from richmap.robots.robot import RobotDescription


def custom_robot(
    path: str | Path,
    base: str,
    end_effector: str,
    approach: str = "z",
    srdf: str | Path | None = None,
    ignore: Iterable[Sequence[str]] = (),
    arguments: str = "",
) -> RobotDescription:
    """Description of an arm of your own.

    Kept is the chain from base to end effector and what is fixed to a link of it; what moves by itself beside it (a
    gripper's fingers, another arm) is left out, and `notes` says so. A link without collision shapes collides with
    nothing. Collision shapes are meshes (scale, unit and origin are honoured), boxes, cylinders and spheres. A
    continuous joint (MJCF: a hinge without a range) gets the range -pi to pi, which covers every posture of it once.
    Meshes named `package://<package>/...` are looked for as `richmap.robots.packages.package_folders` says.

    Args:
        path: URDF, xacro or MJCF file.
        base: Link (MJCF: body) that is fixed to the world.
        end_effector: Link (MJCF: body or site) of which an axis is the approach direction.
        approach: That axis: x, y or z, or one of them with a minus.
        srdf: File that says which pairs of links never touch.
        ignore: Further pairs of links that are not checked for collision.
        arguments: Of a xacro file, as in `name:=ur5e prefix:=left_`.

    Raises:
        ValueError: If there is no such file, frame or mesh, or the arm is none that maps are made of: joints that are
            not revolute, that have no limits or are coupled, a base that does not carry the end effector.
    """
    file = _there(path)
    of_pairs = None if srdf is None else _there(srdf)
    robot = read_arm(file, base, end_effector, approach, of_pairs, ignore, arguments=arguments)
    return replace(robot, name=f"custom-{file.stem}-{robot.fingerprint[:8]}")  # Files of one name are different arms.


def _there(path: Path | str) -> Path:
    try:
        return Path(path).expanduser().resolve()
    except (RuntimeError, OSError) as error:  # There is no such user, or no file can be called so.
        raise ValueError(f"there is no file {str(path):.200} ({error})") from error
