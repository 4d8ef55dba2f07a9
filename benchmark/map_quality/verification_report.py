"""Tables 1 and 2 of the paper beside the same figures measured here, as Markdown."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

TABLE_1 = """
robot map              inserted accuracy fpr  us_1e2 us_1e4 us_1e6
panda rm4d                 1.1   .980   .035  41.9   49.0   45.6
panda capability_map      10.7   .974   .052  78.6   38.3    2.7
panda richmap             11.3   .975   .037  91.4   45.3    2.5
iiwa7 rm4d                 1.1   .982   .035  56.2   49.7   45.2
iiwa7 capability_map       9.8   .972   .058  82.4   43.0    2.7
iiwa7 richmap             10.2   .978   .036  82.0   47.7    2.9
ur5e  rm4d                 1.5   .984   .058  40.7   43.5   46.4
ur5e  capability_map      16.4   .973   .082  71.2   46.1    3.0
ur5e  richmap             18.2   .978   .063  94.1   50.2    3.0
gen3  rm4d                 1.0   .982   .045  47.8   44.9   46.0
gen3  capability_map       9.1   .972   .063  78.6   39.0    2.4
gen3  richmap             10.0   .978   .046  76.1   43.8    2.7
"""
"""The paper's Table 1 (cells of 0.05 m): millions inserted, and query times in microseconds, on a GPU but for RM4D."""

TABLE_2 = """
robot cell_size inserted occupancy avg_per_cell accuracy tpr  fpr  insertion_rate us_2e6
panda 0.05       11.3     .352      503          .975    .982 .037 .064            1.2
iiwa7 0.05       10.2     .435      367          .978    .987 .036 .060            1.3
ur5e  0.05       18.2     .527      541          .978    .992 .063 .055            1.3
gen3  0.05       10.0     .345      454          .978    .991 .046 .054            1.2
panda 0.02      164.1     .328      501          .982    .981 .016 .068           13.5
iiwa7 0.02      145.1     .405      358          .984    .984 .015 .067           15.2
ur5e  0.02      260.0     .495      526          .984    .989 .028 .071           15.1
gen3  0.02      141.1     .322      439          .984    .986 .019 .071           13.2
"""
"""The paper's Table 2 (theta = 0.1 rad)."""

FORMATS = {
    "inserted": "{:.1f}", "occupancy": "{:.3f}", "avg_per_cell": "{:.0f}", "accuracy": "{:.3f}", "tpr": "{:.3f}",
    "fpr": "{:.3f}", "insertion_rate": "{:.3f}", "us_1e2": "{:.3g}", "us_1e4": "{:.3g}", "us_1e6": "{:.3g}",
    "us_2e6": "{:.3g}",
}  # fmt: skip

HEADER = """# Maps against inverse kinematics

Made by `python -m benchmark.map_quality.verify_maps robot=<robot>`. In each cell: *paper / here*. Test set and labels
are those of
each section; `strict`: 1 mm and 0.01 rad, `loose`: mm + degrees <= 25, `wrist_free`: as strict, but at any roll.
Intervals, and how each map was made, are in `verify_maps.parquet`. The paper's set has its shares in each sense of
reachable (half reachable; a tenth outside of the reach, a tenth below ground, three tenths perturbed): a perturbed pose
that the loose tolerance reaches is left out under loose labels, and as many of the other kinds. How far a pose is
perturbed, which the paper does not say, is up to the arm's reach and half a turn; with less, most candidates prove
reachable and the others crowd at the edge of the reach, where a map is wrong most often.

`us_1e6` and so on: microseconds per query on all cores of the machine, in batches of that size, the least of three runs
(test poses over and over; other work may run beside); exact and uncontended figures are in `speed.md`. Capability maps
are built to the paper's number of orientations, so that these agree by construction. RM4D here marks half as many of
its cells as the paper's; what the paper counts it does not say. The paper's text has 160.5 M directions for Panda at
0.02 m and 20.5 M for UR5e at 0.05 m where its table has 164.1 and 18.2.
"""


ROLLS = """## Whole poses: three answers of the map of directions

Share of the poses of each truth (strict labels) that get each answer, in percent. *At another roll*: the approach
direction is reachable there, the pose is not; the map says so where the roll was not seen. Arms whose last joint turns
through all rolls have none.
"""


def markdown(table: "pd.DataFrame", labels: "pd.DataFrame", rolls: "pd.DataFrame") -> str:
    """All tables.

    Args:
        table: Rows of `verify_maps.parquet`.
        labels: Rows of `verify_labels.parquet`.
        rolls: Rows of `verify_rolls.parquet`, or none.
    """
    ours = table.assign(inserted=table.inserted / 1e6)
    for batch in ("1e2", "1e4", "1e6", "2e6"):
        ours[f"us_{batch}"] = 1e6 * ours[f"query_{batch}_s"]
    parts = [HEADER]
    for kind in ("loose", "strict"):
        chosen = ours[(ours.test_set == "paper") & (ours.labels == kind)]
        one = chosen[chosen.cell_size == 0.05]
        two = chosen[chosen["map"] == "richmap"]
        parts += [f"## Table 1: maps at 0.05 m, the paper's test set, {kind} labels", _beside(TABLE_1, one, 2)]
        parts += [
            f"## Table 2: directions 0.1 rad apart, the paper's test set, {kind} labels",
            _beside(TABLE_2, two, 2),
        ]
    columns = ["robot", "map", "cell_size", "test_set", "labels", "n", "accuracy", "tpr", "fpr", "bytes_memory"]
    columns += ["bytes_disk", "build_s"]
    parts += ["## All maps, test sets and labels", table[columns].to_markdown(index=False, floatfmt=".4g", intfmt=",")]
    if len(rolls):
        said = [name for name in rolls if name.startswith("said ")]
        shown = rolls.assign(**{name: 100 * rolls[name] / rolls.n.clip(lower=1) for name in said})
        parts += [ROLLS, shown.to_markdown(index=False, floatfmt=".4g", intfmt=",")]
    parts += [
        "## The labels",
        labels.drop(columns="robot_fingerprint").set_index(["robot", "test_set"]).T.to_markdown(),
    ]
    return "\n\n".join(parts) + "\n"


def _beside(paper: str, ours: "pd.DataFrame", keys: int) -> str:
    """A table whose cells hold the paper's figure and ours; the first columns say what a row is about."""
    import io

    import pandas as pd

    theirs = pd.read_csv(io.StringIO(paper), sep=r"\s+")
    key = list(theirs.columns[:keys])
    both = theirs.merge(ours, on=key, how="left", suffixes=("", "_here"))
    cells = both[key].copy()
    for name in theirs.columns[keys:]:
        here = both[f"{name}_here"]
        cells[name] = [
            " / ".join("–" if pd.isna(x) else FORMATS[name].format(x) for x in pair)
            for pair in zip(both[name], here, strict=True)
        ]
    return cells.to_markdown(index=False)
