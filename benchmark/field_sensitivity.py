"""How the slope of the energy fields along the demonstrations' paths changes with what the paper leaves open.

python -m benchmark.field_sensitivity
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import check_setting, run_command
from benchmark.config import SOURCE, MapConfig, check_folder, check_targets
from benchmark.outputs import replacing

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from matplotlib.figure import Figure
    from rich.console import Console

    from richmap.similarity import DirectionMoments

CHOICES: dict[str, tuple] = {
    "discrepancy": ("mmd", "mmd2"),
    "one_sided": ("masked", "counted"),
    "empty": ("unfilled", "seed"),
    "scales": (5, 3, 7),
    "smoothing": (1.0, 0.5, 2.0),
    "central_radius": (0.1, 0.0, 0.2),
}
"""What the paper leaves open (`richmap.energy_settings`; `scales` is the kernel's M); our choice comes first."""

CELL_SIZE = 0.05
"""Ours, in [m]; a change of it is a choice like the others."""

BIN = 0.05
"""Width of the rings about the base over which slopes are averaged, in [m]."""

NOTHING = 0.1
"""A slope that is a smaller part of the full one, delta / Delta, counts as none; likewise a share of positions."""


@dataclass
class FieldSensitivityConfig:
    """Measures how the energy fields' slope along the demonstrations depends on what the paper leaves open."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]; their rows of this map.cell_size replace older ones in the table."""
    episodes: int = 30
    """Demonstrations whose positions count, from the scene of seed 0 on; a whole number from 1 to 1000."""
    output_dir: str = "results"
    """Folder of field_sensitivity.parquet and field_sensitivity.md; the figure goes to its folder figures."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        check_setting(1 <= self.episodes <= 1000, "episodes", self.episodes, "a whole number from 1 to 1000")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        covered = self.map.half_width >= 0.8
        check_setting(covered, "map.half_width", self.map.half_width, "0.8 or more, so that the field covers the table")
        check_folder(self.output_dir)


@dataclass(frozen=True)
class Statement:
    """Something that is said about the fields."""

    text: str
    robots: tuple[str, ...]
    holds: Callable[..., bool]
    """Given the rings of one field of each of these arms."""


def relative_slope(rings: "pd.DataFrame", low: float = 0.0, high: float = 2.0) -> float:
    """Mean of dE/dR over the positions with R from `low` to `high`, in [m], as a part of the full slope."""
    from richmap.energy_settings import EnergySettings

    inside = rings[(rings.radius > low - 1e-9) & (rings.radius < high - 1e-9)]
    slope = (inside.slope * inside.positions).sum() / max(inside.positions.sum(), 1)
    return float(slope * rings.cell_size.iloc[0] / EnergySettings.step)


def share(rings: "pd.DataFrame", column: str) -> float:
    """Share of all positions that are pushed `inward` or `outward`."""
    return float((rings[column] * rings.positions).sum() / rings.positions.sum())


def pushed_away(rings: "pd.DataFrame") -> bool:
    """The paper's words, read leniently: outward at 10 % of the positions and at no fewer than inward."""
    return share(rings, "outward") >= max(NOTHING, share(rings, "inward"))


TARGETS = ("ur3", "ur5", "ur10")

STATEMENTS = (
    Statement("UR3 is pulled inward beyond R = 0.40 m", ("ur3",), lambda ur3: relative_slope(ur3, 0.40) >= NOTHING),
    Statement("UR3: nothing inside R = 0.35 m", ("ur3",), lambda ur3: abs(relative_slope(ur3, 0, 0.35)) < NOTHING),
    Statement(
        "UR5: nothing where the demonstrations are",
        ("ur5",),
        lambda ur5: share(ur5, "inward") + share(ur5, "outward") <= NOTHING,
    ),
    Statement(
        "UR10 is pushed outward inside R = 0.30 m", ("ur10",), lambda ur10: relative_slope(ur10, 0, 0.3) <= -NOTHING
    ),
    *(Statement(f"The paper: {name.upper()} is pushed away from the base", (name,), pushed_away) for name in TARGETS),
    Statement("UR3's mean slope over all positions points inward", ("ur3",), lambda ur3: relative_slope(ur3) > 0),
    Statement(
        "UR3 is pulled inward more than UR5 and UR10 are, on the mean over all positions",
        TARGETS,
        lambda ur3, ur5, ur10: relative_slope(ur3) > max(relative_slope(ur5), relative_slope(ur10)),
    ),
    Statement(
        "No arm is pushed outward from R = 0.40 to 0.50 m",
        TARGETS,
        lambda *arms: min(relative_slope(arm, 0.4, 0.5) for arm in arms) > -NOTHING,
    ),
)


def main(config: FieldSensitivityConfig) -> None:
    """Build the fields of arm after arm, store their slopes after each, and write table and figure.

    Arms and cell sizes that are in the table of the same maps and code are kept.
    """
    import pandas as pd
    from rich.console import Console

    from benchmark.build_maps import robot_map
    from benchmark.cache import fingerprint
    from richmap import energy, energy_settings, similarity
    from richmap.robots import load_robot

    console, output_dir = Console(), Path(config.output_dir)
    file = output_dir / "field_sensitivity.parquet"
    table = pd.read_parquet(file) if file.exists() else pd.DataFrame(columns=["robot", "cell_size", "fingerprint"])
    path = demonstrated_path(config.episodes, console)
    base = (0.0, 0.0, 0.0)
    source_map = robot_map(load_robot(SOURCE), base, config.map, config.workers, console)
    source_hash, source = source_map.content_hash, similarity.direction_moments(source_map)
    del source_map  # Gigabytes at 0.02 m; the moments are all that is needed of it.
    for name in config.robots:
        target_map = robot_map(load_robot(name), base, config.map, config.workers, console)
        inputs = {"maps": [source_hash, target_map.content_hash], "episodes": config.episodes, "choices": CHOICES}
        key = fingerprint(inputs, [similarity, energy, energy_settings])
        old = (table.robot == name) & (table.cell_size == config.map.cell_size)
        if old.any() and (table.fingerprint[old] == key).all():
            console.print(f"{name} at {config.map.cell_size} m: kept, from the same maps and code.")
            continue
        target = similarity.direction_moments(target_map)
        del target_map
        rows = slopes(source, target, path, console).assign(fingerprint=key)
        table = pd.concat([table[~old], rows] if len(table) else [rows], ignore_index=True)
        with replacing(file) as temporary:
            table.to_parquet(temporary, index=False)
    with replacing(output_dir / "field_sensitivity.md") as temporary:
        temporary.write_text(markdown(table))
    figure_file = output_dir / "figures" / "field_sensitivity.png"
    with replacing(figure_file) as temporary:
        draw(table).savefig(temporary, dpi=150)
    console.print(
        statements(table)[["statement", "ours", "combinations"]].to_markdown(index=False), soft_wrap=True, markup=False
    )
    console.print(f"Table: {output_dir / 'field_sensitivity.md'}, figure: {figure_file}", soft_wrap=True)


def demonstrated_path(episodes: int, console: "Console") -> "np.ndarray":
    """Flange positions, (n, 3), in [m], of the source's oracle in the scenes of the first clean demonstrations."""
    import gymnasium
    import numpy as np

    from benchmark.progress import progress_bar
    from envs import ENVIRONMENTS
    from envs.oracle import run_oracle

    env = gymnasium.make(ENVIRONMENTS[SOURCE])
    with progress_bar(console) as progress:
        infos = [
            info
            for seed in progress.track(range(episodes), description="Demonstrations")
            for info in run_oracle(env, seed)
        ]
    env.close()
    return np.array([info["flange"] for info in infos])


def slopes(
    source: "DirectionMoments", target: "DirectionMoments", path: "np.ndarray", console: "Console"
) -> "pd.DataFrame":
    """Mean of dE/dR over the path's positions in each ring about the base, for every combination of choices.

    Columns: `robot`, `cell_size` in [m], the choices, `radius` (inner one of the ring, in [m]), `positions` (number
    of them there), `slope` in [1/m] (above 0 it pulls inward, since guidance goes against it), `inward` and `outward`
    (shares of these positions where the slope is at least `NOTHING` of the full one).
    """
    import numpy as np
    import pandas as pd

    from benchmark.progress import progress_bar
    from richmap.energy import EnergyField
    from richmap.energy_settings import EnergySettings
    from richmap.similarity import similarity

    radius = np.hypot(path[:, 0], path[:, 1])
    outward = path[:, :2] / radius[:, None]
    ring = np.floor(radius / BIN + 1e-9).astype(int)
    grids = {scales: similarity(source, target, scales=scales) for scales in CHOICES["scales"]}
    combinations = [dict(zip(CHOICES, values, strict=True)) for values in product(*CHOICES.values())]
    rows = []
    with progress_bar(console) as progress:
        for choice in progress.track(combinations, description=f"Fields of {target.robot}"):
            settings = EnergySettings(**{name: value for name, value in choice.items() if name != "scales"})
            field = EnergyField.from_similarity(grids[choice["scales"]], settings, {})
            slope = (field.gradient(path)[:, :2] * outward).sum(1)
            least = NOTHING * settings.step / source.grid.cell_size
            for r in np.unique(ring):
                here = slope[ring == r]
                rows.append(
                    {
                        "robot": target.robot,
                        "cell_size": source.grid.cell_size,
                        **choice,
                        "radius": round(r * BIN, 9),
                        "positions": len(here),
                        "slope": here.mean(),
                        "inward": (here >= least).mean(),
                        "outward": (here <= -least).mean(),
                    }
                )
    return pd.DataFrame(rows)


def single_changes(table: "pd.DataFrame") -> dict[str, tuple]:
    """Cell size and choices of ours, and of each that differs from it in one thing, by a name for it."""
    ours = {"cell_size": CELL_SIZE, **{name: values[0] for name, values in CHOICES.items()}}
    changed = {name: values[1:] for name, values in CHOICES.items()}
    changed["cell_size"] = tuple(sorted(set(table.cell_size) - {CELL_SIZE}, reverse=True))
    single = {f"{name}={value}": ours | {name: value} for name, values in changed.items() for value in values}
    return {label: tuple(choice.values()) for label, choice in {"ours": ours, **single}.items()}


def statements(table: "pd.DataFrame") -> "pd.DataFrame":
    """A row per statement: whether it holds for our choice, for each single change and for all combinations."""
    import pandas as pd

    fields = dict(list(table.groupby(["robot", "cell_size", *CHOICES])))
    rows = []
    for statement in STATEMENTS:

        def verdict(key: tuple, statement: Statement = statement) -> str:
            rings = [fields.get((robot, *key)) for robot in statement.robots]
            return "" if any(r is None for r in rings) else "yes" if statement.holds(*rings) else "no"

        row = {label: verdict(key) for label, key in single_changes(table).items()}
        verdicts = [verdict(key) for key in {key[1:] for key in fields}]
        holds, said = verdicts.count("yes"), len(verdicts) - verdicts.count("")
        always = "" if said == 0 else "yes" if holds == said else "no"
        rows.append({"statement": statement.text, **row, "combinations": f"{holds} of {said}", "always": always})
    return pd.DataFrame(rows)


def slope_table(table: "pd.DataFrame") -> "pd.DataFrame":
    """A row per arm and single change: slope in each ring as percent of the full one, and shares of positions."""
    import pandas as pd

    fields = dict(list(table.groupby(["robot", "cell_size", *CHOICES])))
    rows = []
    for robot, (label, key) in product(table.robot.unique(), single_changes(table).items()):
        rings = fields.get((robot, *key))
        if rings is None:
            continue
        if not rows:
            weights = rings.set_index("radius").positions / rings.positions.sum()
            rows.append({"choice": "positions", **{f"{r:.2f}": f"{100 * w:.0f} %" for r, w in weights.items()}})
        inward, outward = share(rings, "inward"), share(rings, "outward")
        shares = {"inward": inward, "outward": outward, "nothing": 1 - inward - outward}
        rows.append(
            {"arm": robot, "choice": label}
            | {f"{r:.2f}": f"{100 * relative_slope(rings, r, r + BIN):+.0f}" for r in rings.radius}
            | {"mean": f"{100 * relative_slope(rings):+.0f}"}
            | {name: f"{100 * value:.0f} %" for name, value in shares.items()}
        )
    columns = ["arm", "choice", *(c for c in rows[0] if c != "choice"), "mean", *shares]
    return pd.DataFrame(rows, columns=columns).fillna("")


TEXT = """# How the energy fields' slope depends on what the paper leaves open

Slope dE/dR at the flange positions of the xArm6's oracle in the demonstrations' scenes, against the arm's base axis, as
percent of the full slope, which is one step per cell (delta / Delta, 0.2 per metre at Delta = 0.05 m; off the grid's
axes it can be {root:.0f} % of that, since steps are counted along them). Columns are rings of 5 cm that begin at R.
Above 0 guidance pulls inward. *Inward*, *outward*: positions where the slope is at least 10 % of the full one. Made by
`python -m benchmark.field_sensitivity`, the rows of another Delta by adding `map.cell_size=0.02 map.stop_rate=0.1`.

- `discrepancy`: the MMD or its square; `one_sided=counted`: cells that one arm fills have the discrepancy from an empty
  set, which enters tau; `empty=seed`: cells without a discrepancy are seeds; `scales`: the kernel's M; `smoothing`:
  standard deviation of the Gaussian filter in cells; `central_radius`: of the region at the base that is never a seed,
  in m; `cell_size`: Delta in m.
- *ours*: {ours}. Every other row changes one thing.

{slopes}

## What holds

For our choice, for each single change, and for all combinations of the choices, at every Delta in the table.
"Pulled" and "pushed": the mean slope over those positions is at least 10 % of the full one; "nothing": below 10 %, or
at most 10 % of the positions are pushed; "the paper": at least 10 % of the positions are pushed outward, and no fewer
than inward.

{numbered}

{verdicts}

{always}
"""


def markdown(table: "pd.DataFrame") -> str:
    """The tables for people."""
    held = statements(table)
    held.index += 1
    always = [f"- {text}" for text in held.statement[held.always == "yes"]]
    verdicts = held.drop(columns="statement").T.reset_index(names="choice")
    return TEXT.format(
        root=100 * 2**0.5,
        ours=", ".join([f"cell_size={CELL_SIZE}", *(f"{name}={values[0]}" for name, values in CHOICES.items())]),
        slopes=slope_table(table).to_markdown(index=False, disable_numparse=True),
        numbered="\n".join(f"{number}. {text}" for number, text in held.statement.items()),
        verdicts=verdicts.to_markdown(index=False, disable_numparse=True),
        always="\n".join(["Whatever is chosen:", "", *always]) if always else "Nothing holds whatever is chosen.",
    )


def draw(table: "pd.DataFrame") -> "Figure":
    """For each arm the slope over R: ours, each single change, and the range over all combinations."""
    from matplotlib.figure import Figure

    from richmap.energy_settings import EnergySettings

    table = table.assign(slope=table.slope * table.cell_size / EnergySettings.step, radius=table.radius + BIN / 2)
    fields = dict(list(table.groupby(["robot", "cell_size", *CHOICES])))
    robots = list(table.robot.unique())
    figure = Figure(figsize=(4 * len(robots) + 2, 4), layout="constrained")
    for axes, robot in zip(figure.subplots(1, len(robots), squeeze=False, sharey=True)[0], robots, strict=True):
        of_arm = table[table.robot == robot].groupby("radius")
        low, high, weight = of_arm.slope.min(), of_arm.slope.max(), of_arm.positions.first()
        axes.fill_between(low.index, low, high, color="0.9", label="all combinations")
        for number, (label, key) in enumerate(single_changes(table).items()):
            rings = fields.get((robot, *key))
            style = {"color": "black", "linewidth": 3} if label == "ours" else {"color": f"C{number - 1}"}
            if rings is not None:
                axes.plot(rings.radius, rings.slope, label=label, linestyle="-" if number <= 10 else "--", **style)
        axes.bar(weight.index, weight / weight.sum(), BIN, bottom=-1.2, color="0.6", label="share of positions")
        axes.set(title=robot, xlabel="distance from the base R [m]", ylim=(-1.2, 1.3))
    figure.axes[0].set_ylabel("dE/dR as part of the full slope\noutward   <   0   <   inward")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), fontsize="small", loc="outside right center")
    return figure


if __name__ == "__main__":
    run_command(main, FieldSensitivityConfig, "field_sensitivity")
