"""What a check of a path leaves behind: tables, a cloud of points, a picture and a page."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from benchmark.artifacts.scene_page import ARM, Bar, Colour, arm_meshes, boxes, save_page, turned_up
from richmap.motion.reach import reach_ball
from richmap.outputs import replacing
from richmap.paths.path_check import PathCheck, Reason
from richmap.progress import number_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS: dict[Reason, Colour] = {
    Reason.FOLLOWED: (60, 160, 80, 255),
    Reason.OUT_OF_REACH: (200, 40, 40, 255),
    Reason.JOINT_LIMIT: (240, 140, 20, 255),
    Reason.SELF_COLLISION: (130, 60, 170, 255),
    Reason.WRONG_BRANCH: (30, 110, 200, 255),
    Reason.TOO_FAST: (120, 120, 120, 255),
}

SHOWN = 6000
"""Poses that the page shows at most, evenly taken."""
EDGE = 0.007
"""Of the cube at a pose, in [m]."""
MOST_MMD = 2**0.5
"""No two sets of directions differ by more."""


def save_check(check: PathCheck, folder: Path, colour: str = "reason") -> None:
    """Write steps.csv, steps.npz, losses.csv, poses.ply, check.png and check.html.

    Args:
        check: What is written.
        folder: Where to.
        colour: What the page's poses are coloured by, `reason` or `mmd`.
    """
    import trimesh

    steps = step_table(check)
    with replacing(folder / "steps.csv") as file:
        steps.to_csv(file, index=False)
    with replacing(folder / "losses.csv") as file:
        loss_table(check).to_csv(file, index=False)
    arrays = {str(name): np.asarray(steps[name], dtype="U" if name == "reason" else None) for name in steps}
    with replacing(folder / "steps.npz") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    shades = np.array([COLOURS[Reason(int(reason))] for reason in check.reason], dtype=np.uint8)
    with replacing(folder / "poses.ply") as file:
        file.write_bytes(trimesh.PointCloud(check.path.positions, shades).export(file_type="ply"))
    with replacing(folder / "check.png") as file:
        draw(check).savefig(file, dpi=120)
    scene, title, legend, bar = page(check, colour)
    save_page(scene, folder / "check.html", title, legend, bar)


def step_table(check: PathCheck) -> pd.DataFrame:
    """One row per step: its pose, in [m], what became of it, and the joints, in [rad]."""
    path = check.path
    step = np.concatenate([np.arange(span.stop - span.start) for span in path.spans])
    table = pd.DataFrame({"episode": path.episodes, "step": step})
    table[["x", "y", "z"]] = path.positions
    table[["qx", "qy", "qz", "qw"]] = Rotation.from_matrix(path.rotations).as_quat()
    table = table.assign(
        followed=check.followed,
        reason=[Reason(int(reason)).words for reason in check.reason],
        reachable=check.reachable,
    )
    if check.mapped is not None:
        table["mapped"] = check.mapped
    if check.mmd is not None:
        table["mmd"] = check.mmd
    joints = pd.DataFrame(check.joints, columns=[f"joint_{name}" for name in check.robot.joints])
    return pd.concat([table, joints], axis=1)


def loss_table(check: PathCheck) -> pd.DataFrame:
    """One row per stretch of lost steps: where it begins, how long it is, and why."""
    columns = ["episode", "step", "steps", "reason", "x", "y", "z", "about"]
    rows = [(lost.episode, lost.step, lost.steps, lost.reason.words, *lost.position, lost.about) for lost in check.lost]
    return pd.DataFrame(rows, columns=columns)


def draw(check: PathCheck) -> "Figure":
    """The path from above and from the side, with its reasons and the arm's reach, and each episode step by step."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    above, side, episodes = figure.subplots(1, 3)
    shoulder, radius = reach_ball(check.robot)
    for axes, (i, j), title in ((above, (0, 1), "from above"), (side, (0, 2), "from the side")):
        for reason, colour in COLOURS.items():
            of = check.path.positions[check.reason == reason]
            if len(of):
                label = f"{reason.words}: {len(of)}"
                axes.plot(of[:, i], of[:, j], ".", ms=2, color=np.array(colour) / 255, label=label)
        axes.add_patch(Circle((shoulder[i], shoulder[j]), radius, fill=False, ls=":", color="0.5", label="reach"))
        axes.plot(0, 0, "k+", ms=6, label="base")
        axes.set(title=title, xlabel="x [m]", ylabel=f"{'xyz'[j]} [m]", aspect="equal")
    above.legend(fontsize="x-small", loc="best", markerscale=2)
    spans = check.path.spans
    picture = np.full((len(spans), max(span.stop - span.start for span in spans), 4), 255, dtype=np.uint8)
    for row, span in zip(picture, spans, strict=True):
        row[: span.stop - span.start] = [COLOURS[Reason(int(reason))] for reason in check.reason[span]]
    episodes.imshow(picture, aspect="auto", interpolation="nearest")
    episodes.set(title="episodes", xlabel="step", ylabel="episode, as they come")
    figure.suptitle(
        f"{check.robot.name}: {100 * check.steps_followed:.1f} % of {number_of('step', len(check.reason))} and "
        f"{100 * check.episodes_followed:.1f} % of {number_of('episode', len(spans))} are followed"
    )
    return figure


def page(check: PathCheck, colour: str) -> tuple:
    """Scene, title, legend and colour bar of the page: the arm at the first step that it follows, and the poses."""
    import trimesh
    from matplotlib import colormaps

    n = len(check.reason)
    some = np.unique(np.linspace(0, n - 1, min(n, SHOWN)).round().astype(int))
    bar, of_reasons = None, []
    if colour == "mmd" and check.mmd is not None:
        known = np.nan_to_num(check.mmd[some] / MOST_MMD, nan=1.0)
        shades = colormaps["magma_r"](known, bytes=True)
        bar = Bar("MMD of directions, source against arm (most where a map has none)", "magma_r", 0, round(MOST_MMD, 2))
    else:
        shades = np.array([COLOURS[Reason(int(reason))] for reason in check.reason[some]], dtype=np.uint8)
        counts = {reason: int((check.reason == reason).sum()) for reason in COLOURS}
        of_reasons = [(f"{r.words}: {number_of('step', k)}", COLOURS[r]) for r, k in counts.items() if k]
    cubes = boxes(check.path.positions[some], EDGE, shades)
    scene = trimesh.Scene()
    scene.add_geometry(cubes, node_name="poses", geom_name="poses")
    stand, said = np.zeros(len(check.robot.joints)), "with its joints at 0"
    if check.followed.any():
        stand, said = check.joints[np.argmax(check.followed)], "at the first step that it follows"
    for link, mesh in arm_meshes(check.robot, stand).items():
        scene.add_geometry(mesh, node_name=link, geom_name=link)
    left_out = "" if len(some) == n else f", {len(some)} of {n} are shown"
    title = f"{check.robot.name} along the path: {100 * check.steps_followed:.1f} % of the steps followed{left_out}"
    return turned_up(scene), title, [(f"the arm {said}", ARM), *of_reasons], bar
