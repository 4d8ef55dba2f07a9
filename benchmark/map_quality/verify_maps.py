"""Accuracy, TPR and FPR of an arm's maps on test poses that inverse kinematics has labelled, beside the paper's.

python -m benchmark.map_quality.verify_maps robot=panda
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.outputs import store_rows
from benchmark.map_quality.verified_maps import MAPS, VerifiedMap
from benchmark.map_quality.verify_config import VerifyMapsConfig
from benchmark.settings.command import run_command
from benchmark.settings.setting import SettingError, check_choice
from richmap.outputs import replacing

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from rich.console import Console

    from benchmark.map_quality.labels import LabelledPoses
    from richmap.robots.robot import RobotDescription

BATCHES = (100, 10_000, 1_000_000, 2_000_000)
"""Poses asked for at once when queries are timed."""

KEY = ["robot", "map", "cell_size", "test_set", "labels"]
"""What one row of the table is about."""

ROLL_KEY = ["robot", "cell_size", "test_set", "truth"]
"""What one row of the table of rolls is about."""

RATES = ("accuracy", "tpr", "fpr")


def main(config: VerifyMapsConfig) -> None:
    """Label the test poses, build what is missing, and write the tables."""
    import pandas as pd

    from benchmark.map_quality.labels import TEST_SETS
    from richmap.progress import plain_console

    for name in config.maps:
        check_choice("maps", name, MAPS)
    console, output_dir = plain_console(), Path(config.output_dir)
    robot = config.robot.load()
    try:
        poses = {test_set: label_poses(robot, test_set, config, console) for test_set in TEST_SETS}
    except ValueError as error:  # An arm too large or too small for the paper's workspace.
        raise SettingError(str(error)) from error
    for test_set, labelled in poses.items():
        check_labels(robot, test_set, labelled, config, console)
    for verified in _verified_maps(robot, config, console):
        rows = verify(robot, verified, poses)
        table = store_rows(output_dir / "verify_maps.parquet", pd.DataFrame(rows), KEY)
        for row in rows:
            console.print(
                f"{row['robot']} {row['map']} {row['cell_size']} m, {row['test_set']} {row['labels']}: accuracy "
                f"{row['accuracy']:.4f}, TPR {row['tpr']:.4f}, FPR {row['fpr']:.4f}",
                soft_wrap=True,
            )
        if verified.score:
            curve = pd.DataFrame(threshold_curve(robot, verified, poses))
            store_rows(output_dir / "verify_curves.parquet", curve, [*KEY, "threshold"])
        if verified.reach:
            store_rows(output_dir / "verify_rolls.parquet", pd.DataFrame(confusion(robot, verified, poses)), ROLL_KEY)
        report(output_dir, table)
    console.print(f"Tables: {output_dir / 'verify_maps.md'}", soft_wrap=True)


def _verified_maps(robot: "RobotDescription", config: VerifyMapsConfig, console: "Console") -> Iterator[VerifiedMap]:
    """The maps asked for, one after the other; one that this arm cannot have is said and left out."""
    from richmap.motion.turned_cells import NoTurnError

    for name in config.maps:
        try:
            yield from MAPS[name](robot, config, console)
        except NoTurnError as error:
            console.print(f"{name} is left out. {error}", soft_wrap=True)


def label_poses(
    robot: "RobotDescription", test_set: str, config: VerifyMapsConfig, console: "Console"
) -> "LabelledPoses":
    """The test split of a set, from the cache as far as it is there."""
    from benchmark.map_quality.labels import labelled
    from richmap.progress import progress_bar

    with progress_bar(console) as progress:
        task = progress.add_task(f"Test poses of {robot.name}, {test_set}", total=config.poses)
        return labelled(
            robot, test_set, "test", config.poses, config.workers, lambda done: progress.update(task, completed=done)
        )


def check_labels(
    robot: "RobotDescription", test_set: str, labelled: "LabelledPoses", config: VerifyMapsConfig, console: "Console"
) -> None:
    """Store what a test set consists of and how far its labels can be trusted, unless that is stored."""
    import pandas as pd

    file, key = Path(config.output_dir) / "verify_labels.parquet", ["robot", "test_set"]
    about = {"robot": robot.name, "test_set": test_set, "n": len(labelled), "robot_fingerprint": robot.fingerprint}
    about["checked"] = min(config.checked, len(labelled))
    if file.exists() and (pd.read_parquet(file)[list(about)] == pd.Series(about)).all(axis=1).any():
        return
    with console.status(f"Checking the labels of {robot.name}, {test_set}"):
        store_rows(file, pd.DataFrame([labels_row(robot, test_set, labelled, config)]), key)


def labels_row(
    robot: "RobotDescription", test_set: str, labelled: "LabelledPoses", config: VerifyMapsConfig
) -> dict[str, object]:
    """What a test set consists of, and how far its labels can be trusted."""
    import numpy as np

    from benchmark.map_quality.label_errors import label_errors
    from benchmark.map_quality.labels import LABELS

    row = {"robot": robot.name, "test_set": test_set, "n": len(labelled), "robot_fingerprint": robot.fingerprint}
    row |= {f"reachable_{name}": float(getattr(labelled, name).mean()) for name in LABELS}
    row |= {f"drawn_{kind.replace(' ', '_')}": count for kind, count in labelled.drawn.items()}
    return row | label_errors(robot, labelled, config.checked, np.random.default_rng(0))


def verify(
    robot: "RobotDescription", verified: VerifiedMap, poses: "dict[str, LabelledPoses]"
) -> list[dict[str, object]]:
    """A row for each test set and each kind of label."""
    from benchmark.artifacts.commit import commit
    from benchmark.map_quality.labels import LABELS

    about = {name: getattr(verified, name) for name in ("cell_size", "inserted", "occupancy", "avg_per_cell", "made")}
    about |= {name: getattr(verified, name) for name in ("insertion_rate", "build_s", "bytes_memory", "bytes_disk")}
    about = {
        "robot": robot.name,
        "map": verified.name,
        "commit": commit(),
        **about,
        **query_times(verified, next(iter(poses.values()))),
    }
    rows = []
    for test_set, labelled in poses.items():
        predicted = verified.reachable(labelled.positions, labelled.rotations)
        for labels in LABELS:
            kept = half_and_half(labelled, labels)
            truth = getattr(labelled, labels)[kept]
            rows.append({**about, "test_set": test_set, "labels": labels, **scores(predicted[kept], truth)})
    return rows


def threshold_curve(
    robot: "RobotDescription", verified: VerifiedMap, poses: "dict[str, LabelledPoses]"
) -> list[dict[str, object]]:
    """Accuracy, TPR and FPR on strict labels for thresholds from 0 to 1, a row for each and each test set."""
    import numpy as np

    about = {"robot": robot.name, "map": verified.name, "cell_size": verified.cell_size, "labels": "strict"}
    rows = []
    for test_set, labelled in poses.items():
        score = verified.score(labelled.positions, labelled.rotations)
        for threshold in np.linspace(0.01, 0.99, 99).round(2):
            rates = scores(score >= threshold, labelled.strict)
            kept = {name: rates[name] for name in ("n", *RATES)}
            rows.append({**about, "test_set": test_set, "threshold": threshold, **kept})
    return rows


def confusion(
    robot: "RobotDescription", verified: VerifiedMap, poses: "dict[str, LabelledPoses]"
) -> list[dict[str, object]]:
    """What is answered of whole poses, a row for each test set and each truth: counts of the three answers."""
    from richmap.maps.reachability_map import Reach

    rows = []
    for test_set, labelled in poses.items():
        answer = verified.reach(labelled.positions, labelled.rotations)
        truths = {
            "reachable": labelled.strict,
            "at another roll": labelled.wrist_free & ~labelled.strict,
            "unreachable": ~labelled.wrist_free & ~labelled.strict,
        }
        for truth, rows_of in truths.items():
            said = answer[rows_of]
            counts = {"reachable": said == Reach.REACHABLE, "at another roll": said == Reach.ROLL_NOT_SEEN}
            counts["unreachable"] = ~(counts["reachable"] | counts["at another roll"])
            about = {"robot": robot.name, "cell_size": verified.cell_size, "test_set": test_set, "truth": truth}
            rows.append(about | {"n": len(said)} | {f"said {name}": int(hits.sum()) for name, hits in counts.items()})
    return rows


def draw_curves(curves: "pd.DataFrame", table: "pd.DataFrame", folder: Path) -> None:
    """Accuracy against FPR, strict labels: a line for each map with a threshold, a point for each other answer."""
    import matplotlib.pyplot as plt

    robots = list(curves.robot.unique())
    figure, axes = plt.subplots(
        2, len(robots), figsize=(3.4 * len(robots), 6), layout="constrained", squeeze=False, sharex=True, sharey=True
    )
    for column, robot in enumerate(robots):
        for axis, test_set in zip(axes[:, column], ("hard", "paper"), strict=True):
            own = (curves.robot == robot) & (curves.test_set == test_set) & (curves["map"] == "fraction")
            for size, line in curves[own].groupby("cell_size"):
                axis.plot(100 * line.fpr, 100 * line.accuracy, label=f"fraction map, {size:g} m")
            points = table[(table.robot == robot) & (table.test_set == test_set) & (table.labels == "strict")]
            on_line = points["map"].str.startswith("fraction")
            axis.plot(100 * points.fpr[on_line], 100 * points.accuracy[on_line], "k.", label="thresholds chosen")
            for _, point in points[~on_line].iterrows():
                label = f"{point['map']}, {point.cell_size:g} m"
                axis.plot(100 * point.fpr, 100 * point.accuracy, "x", label=label)
            axis.set(title=f"{robot}, {test_set} set", xlabel="FPR [%]", ylabel="Accuracy [%]", xlim=(0, 30))
            axis.set_ylim(85, 100)
            axis.grid(alpha=0.3)
            axis.legend(fontsize=6)
    with replacing(folder / "verify_curves.png") as file:
        figure.savefig(file, dpi=150)
    plt.close(figure)


def half_and_half(labelled: "LabelledPoses", labels: str) -> "np.ndarray":
    """Rows to score: all, unless the set has poses that are reachable by construction, as the paper's has.

    Then a candidate that proves reachable in the sense of these labels has no place in it, and of the others as many
    stay as keep the set's shares.
    """
    import numpy as np

    from benchmark.map_quality.labels import TEST_SETS
    from benchmark.map_quality.poses import DRAWS

    kinds, shares = list(DRAWS), TEST_SETS["paper"]
    reachable = labelled.kind == kinds.index("reachable")
    if not reachable.any():
        return np.arange(len(labelled))
    fit = reachable == getattr(labelled, labels)
    rows = {kind: np.flatnonzero(fit & (labelled.kind == kinds.index(kind))) for kind in shares}
    n = min(len(rows[kind]) / share for kind, share in shares.items())
    return np.sort(np.concatenate([rows[kind][: round(n * share)] for kind, share in shares.items()]))


def scores(predicted: "np.ndarray", truth: "np.ndarray") -> dict[str, float]:
    """Accuracy, true and false positive rate with Wilson intervals; NaN where there is no pose of a kind."""
    from benchmark.scoring.statistics import rate_interval

    row = {"n": len(truth), "n_reachable": int(truth.sum())}
    for name, hits in (("accuracy", predicted == truth), ("tpr", predicted[truth]), ("fpr", predicted[~truth])):
        nan = float("nan")
        row[name] = float(hits.mean()) if len(hits) else nan
        row[f"{name}_low"], row[f"{name}_high"] = rate_interval(hits.astype(float)) if len(hits) else (nan, nan)
    return row


def query_times(verified: VerifiedMap, labelled: "LabelledPoses") -> dict[str, float]:
    """Seconds per pose for each batch size, the best of some repeats, on the poses of a test set over and over."""
    import numpy as np

    rotations, times = labelled.rotations, {}
    for batch in BATCHES:
        rows = np.resize(np.arange(len(labelled)), batch)
        positions, oriented = labelled.positions[rows], rotations[rows]
        verified.reachable(positions[:100], oriented[:100])
        seconds = []
        for _ in range(20 if batch <= 10_000 else 3):
            start = time.perf_counter()
            verified.reachable(positions, oriented)
            seconds.append(time.perf_counter() - start)
        times[f"query_{batch:.0e}_s".replace("+0", "")] = min(seconds) / batch
    return times


def report(output_dir: Path, table: "pd.DataFrame") -> None:
    """Write tables and figure for people."""
    import pandas as pd

    from benchmark.map_quality.verification_report import markdown

    labels = pd.read_parquet(output_dir / "verify_labels.parquet")
    with replacing(output_dir / "verify_maps.md") as path:
        rolls = output_dir / "verify_rolls.parquet"
        rolls = pd.read_parquet(rolls).sort_values(ROLL_KEY) if rolls.exists() else pd.DataFrame()
        path.write_text(markdown(table.sort_values(KEY), labels.sort_values(["robot", "test_set"]), rolls))
    curves = output_dir / "verify_curves.parquet"
    if curves.exists():
        draw_curves(pd.read_parquet(curves), table, output_dir / "figures")


if __name__ == "__main__":
    run_command(main, VerifyMapsConfig, "verify_maps")
