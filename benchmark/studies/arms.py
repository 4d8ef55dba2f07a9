"""The arms that have a name: what each reaches of the task, from where, and a picture of all.

python -m benchmark.studies.arms
"""

from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.paths import check_folder
from benchmark.settings.setting import check_choice, check_setting
from envs.arm.place_arm import COMMON_BASE
from envs.block_push.workspace import POSES
from richmap.outputs import replacing
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from richmap.robots.robot import RobotDescription

PLACES = [
    COMMON_BASE,
    *product((-0.8, -0.6, -0.4, -0.3, -0.2, -0.1, 0.0, 0.1), (-0.2, -0.1, 0.0), (0.0, 0.1, 0.2, 0.3, 0.4)),
]
"""Candidates for the base, x, y, z in [m], the common one first: behind the blocks, at the table's height or above."""
VERSION = 1
"""Raised where the same arm would get another row."""
COLUMNS, TILE = 6, 210
"""Pictures in a row of the sheet, and their width and height in pixels."""


@dataclass
class ArmsConfig:
    """Writes a table and a picture of the arms that have a name."""

    robots: list[str] = field(default_factory=lambda: [*ROBOTS])
    """Arms whose rows are computed where they are missing; of others, what there is is shown."""
    output_dir: str = "docs"
    """Folder of arms.md; the picture goes to its folder images."""
    table: str = "results/arms.csv"
    """File of what was computed; only arms that it lacks, or of which it has another description, are computed."""

    def __post_init__(self) -> None:
        for name in self.robots:
            check_choice("robots", name, ROBOTS)
        check_folder(self.output_dir)
        check_setting(self.table.endswith(".csv"), "table", self.table, "a .csv file")


def main(config: ArmsConfig) -> None:
    """Compute the rows that are missing, and write the table and the picture."""
    import pandas as pd

    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot, robot_file

    console, table = plain_console(), Path(config.table)
    rows = {row["robot"]: row for row in read_rows(table).to_dict("records")}
    for name in config.robots:
        key = load_robot(name).fingerprint, robot_file(name).scale, VERSION
        row = rows.get(name, {"best": np.nan})
        if np.isnan(row["best"]) or tuple(row[each] for each in ("fingerprint", "scale", "version")) != key:
            rows[name] = row_of(name)
            console.print(rows[name])
            with replacing(table) as file:
                pd.DataFrame([rows[each] for each in ROBOTS if each in rows]).to_csv(file, index=False)
    picture = Path(config.output_dir) / "images" / "arms.png"
    with replacing(picture) as file:
        file.write_bytes(small_png(sheet(read_rows(table))))
    with replacing(Path(config.output_dir) / "arms.md") as file:
        file.write_text(markdown(read_rows(table)))
    console.print(f"Table: {Path(config.output_dir) / 'arms.md'}, picture: {picture}", soft_wrap=True)


def read_rows(file: Path) -> "pd.DataFrame":
    """Rows that were computed; none if there is no file."""
    import pandas as pd

    return pd.read_csv(file) if file.exists() else pd.DataFrame({"robot": []})


def row_of(name: str) -> dict[str, Any]:
    """What an arm reaches, and which share of the task's poses it can do from where."""
    from richmap.robots.robots import load_robot, robot_file

    robot, scale = load_robot(name), robot_file(name).scale
    placed = robot.in_units_of(scale)
    found = [share_from(placed, base) for base in PLACES]
    shares = np.array([share for share, _ in found])
    away = np.linalg.norm(np.array(PLACES), axis=1)
    best = min(np.flatnonzero(shares >= shares.max() - 1e-9), key=away.__getitem__)
    x, y, z = PLACES[best] if shares[best] > 0 else COMMON_BASE
    return {
        "robot": robot.name, "fingerprint": robot.fingerprint, "version": VERSION, "scale": scale,
        "common": round(float(shares[0]), 3), "best": round(float(shares[best]), 3),
        "x": x, "y": y, "z": z, "posture": " ".join(f"{q:.3f}" for q in found[best][1]),
    }  # fmt: skip


def share_from(robot: "RobotDescription", base: tuple[float, float, float]) -> tuple[float, np.ndarray]:
    """Share of the task's poses that an arm follows from where it stands, and its posture at the start, in [rad].

    0 where it cannot hold its tool upright over the start; its posture is then in the middle of its limits.
    """
    from envs.arm.found_posture import best_posture, followed_share
    from envs.arm.placed_arm import PlacedArm
    from envs.arm.task_poses import FOUND

    # Limits and self-collision bind; its convex parts are not asked for, as they would be by `place_arm`.
    arm = PlacedArm(robot, "embodied", base, 0.0, (), FOUND, (), self_collision=True, joint_limits=True)
    try:
        posture = best_posture(arm, POSES)
    except ValueError:  # Out of reach of the start.
        return 0.0, (robot.lower + robot.upper) / 2
    return followed_share(replace(arm, posture=tuple(posture)), POSES), posture


TEXT = """# Arms that have a name

Made by `python -m benchmark.studies.arms`. `robot=<name>` takes each of them in every command. Each is one file,
`richmap/robots/<name>.yaml`, which says where it is read from, what is put right and why
([how to add one](add-arm.md)). The convex parts that simulators collide ship with it.

*Reach*: of the flange from the shoulder. *Common base*, *best place*: share of block push's {poses} poses (a grid of
{spacing} m at the flange's height of {height} m) over which the arm holds its tool upright, in the best branch that is
found there, within its joint limits, free of self-collision and above the table; from the common base, and from the
best of {places} places (x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m, z {z0:g} to {z1:g} m), of equal ones the nearest
to the common base. *None*: it cannot hold its tool over the start{unknown}. A base above the table
stands on a pedestal. This is coarse, and says which arms are worth a closer look
(`python -m benchmark.studies.place_bases robots=[...]`); it is no score.

*Scale*: what all lengths of the task are multiplied by for an arm that is too small for it ([how](add-arm.md)): the
largest tenth at which it does 90 % of the poses from the common base, or else its most. The shares are of that task
then, and x, y, z in its metres, of which one is that many of the arm's.

{table}

![every arm at the start of the task from its best place, or in the middle of its limits; the red rod is the approach \
direction](images/arms.png)
"""


def markdown(rows: "pd.DataFrame") -> str:
    """The page."""
    import pandas as pd

    from richmap.motion.reach import reach_ball
    from richmap.robots.robots import load_robot, robot_file

    lines = []
    by_name = {row["robot"]: row for row in rows.to_dict("records")}
    for name in ROBOTS:
        robot, scale, row = load_robot(name), robot_file(name).scale, by_name.get(name)
        place = f"{row['x']:g}, {row['y']:g}, {row['z']:g}" if row and row["best"] > 0 else ""
        lines.append(
            {
                "arm": name,
                "joints": len(robot.joints),
                "reach [m]": f"{reach_ball(robot)[1]:.2f}",
                "scale": "" if scale == 1 else f"{scale:g}",
                "common base": _share(row and row["common"]),
                "best place": _share(row and row["best"]),
                "x, y, z [m]": place,
                "read from": robot.source,
                "licence": robot.licence,
            }
        )
    (x0, y0, z0), (x1, y1, z1) = np.min(PLACES, axis=0), np.max(PLACES, axis=0)
    return TEXT.format(
        unknown="; *?*: it was not computed" if any(line["best place"] == "?" for line in lines) else "",
        poses=len(POSES.points()), spacing=POSES.spacing, height=POSES.start[2], places=len({*PLACES}), x0=x0, x1=x1,
        y0=y0, y1=y1, z0=z0, z1=z1, table=pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True),
    )  # fmt: skip


def _share(share: float | None) -> str:
    """For people; None or NaN where it was not computed."""
    if share is None or np.isnan(share):
        return "?"
    return f"{share:.0%}" if share else "none"


def sheet(rows: "pd.DataFrame") -> "Figure":
    """A picture of each arm, in the posture of its row, or else in the middle of its limits."""
    from matplotlib.figure import Figure

    from richmap.robots.robots import load_robot

    lines, postures = -(-len(ROBOTS) // COLUMNS), dict(zip(rows.robot, rows.get("posture", []), strict=False))
    figure = Figure(figsize=(COLUMNS * TILE / 100, lines * (TILE + 22) / 100), dpi=100)
    figure.subplots_adjust(0, 0, 1, 0.985, 0.0, 0.1)
    axes = figure.subplots(lines, COLUMNS).ravel()
    for ax in axes:
        ax.axis("off")
    for ax, name in zip(axes, ROBOTS, strict=False):
        robot, posture = load_robot(name), postures.get(name)
        middle = (robot.lower + robot.upper) / 2
        joints = np.array(posture.split(), dtype=float) if isinstance(posture, str) else middle
        ax.imshow(portrait(robot, joints))
        ax.set_title(name, fontsize=9, pad=2)
    return figure


def portrait(robot: "RobotDescription", joints: np.ndarray) -> np.ndarray:
    """An arm in a posture, in [rad], seen from ahead of its right side; a red rod along its approach direction."""
    import mujoco

    from envs.arm.renderer import Renderer
    from richmap.physics.mujoco_model import VISUAL_GROUP, add_visual_meshes, kinematic_spec

    spec = kinematic_spec(robot)
    add_visual_meshes(spec, robot)
    for geom in spec.geoms:
        geom.rgba = [0.75, 0.77, 0.8, 1]
    data, points = seen_points(spec.compile(), joints)
    centre, size = (points.max(0) + points.min(0)) / 2, np.linalg.norm(np.ptp(points, axis=0))
    rod = {"fromto": [0, 0, 0, 0, 0, 0.1 * size], "size": [0.012 * size, 0, 0], "rgba": [0.9, 0.1, 0.1, 1]}
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.body(robot.end_effector).add_geom(type=cylinder, group=VISUAL_GROUP, mass=0, **rod)
    away = np.array([1.0, -1.1, 0.6])
    spec.worldbody.add_camera(
        name="front",
        pos=centre + 1.3 * size * away / np.linalg.norm(away),
        xyaxes=[1.1, 1.0, 0, *np.cross(away, [1.1, 1.0, 0])],
    )
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.6] * 3
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
                     rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48)  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_forward(model, data)
    renderer = Renderer(model, 2 * TILE, 2 * TILE)
    picture = renderer.draw(data, 2 * TILE, 2 * TILE)
    renderer.close()
    return picture


def seen_points(model: Any, joints: np.ndarray) -> tuple[Any, np.ndarray]:
    """The model's state in a posture, and the vertices of its meshes in the base frame, in [m]."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    points = [np.zeros((1, 3))]
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        points.append(vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    return data, np.concatenate(points)


def small_png(figure: "Figure") -> bytes:
    """A figure in few colours."""
    from PIL import Image

    whole, small = BytesIO(), BytesIO()
    figure.savefig(whole, dpi=100)
    Image.open(whole).convert("RGB").quantize(64).save(small, "png", optimize=True)
    return small.getvalue()


if __name__ == "__main__":
    run_command(main, ArmsConfig, "arms")
