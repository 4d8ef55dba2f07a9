"""What was known of arms beforehand against what came of them: ranks, calibration, what each predictor adds."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.stats import rankdata, spearmanr

from benchmark.scoring.expected_success import margin, on_curve
from benchmark.studies.dose_response_predictors import PREDICTORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWS = 2000
"""Times that arms are drawn anew for an interval."""

LEAST = 4
"""Arms that a rank correlation is of, at least."""

FITTED = "tracked"
"""The predictor from which success is predicted."""


def present(table: pd.DataFrame) -> list[str]:
    """Predictors that a table has."""
    return [name for name in PREDICTORS if name in table and table[name].notna().any()]


def rank_correlation(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Spearman's; NaN where too few arms are known, or all are alike."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < LEAST or np.ptp(x[known]) == 0 or np.ptp(y[known]) == 0:
        return np.nan
    return float(spearmanr(x[known], y[known]).statistic)


def partial_correlation(table: pd.DataFrame, name: str) -> float:
    """Rank correlation of success with what a predictor's ranks say beyond those of the others."""
    names = present(table)
    known = table[[*names, "success"]].dropna()
    if len(known) < len(names) + LEAST - 1:
        return np.nan
    ranks = {each: rankdata(known[each]) for each in (*names, "success")}
    others = np.column_stack([np.ones(len(known)), *(ranks[each] for each in names if each != name)])
    own, success = (y - others @ np.linalg.lstsq(others, y, rcond=None)[0] for y in (ranks[name], ranks["success"]))
    size = np.sqrt(own @ own * (success @ success))
    return float(own @ success / size) if size > 1e-9 else np.nan


def clusters(table: pd.DataFrame) -> Int[np.ndarray, " n"]:
    """Which arms are drawn together: each by itself, and all of the family as one."""
    return np.where(table.family, -1, np.arange(len(table)))


def interval(
    table: pd.DataFrame, statistic: Callable[[pd.DataFrame], float], draws: int = DRAWS, seed: int = 0
) -> tuple[float, float]:
    """Of 95 %, for other arms: clusters are drawn anew, with replacement; NaN where it is of a single one.

    Args:
        table: A row per arm.
        statistic: A function of such a table.
        draws: How often they are drawn.
        seed: Of the draws.
    """
    of = clusters(table)
    kinds, rng = np.unique(of), np.random.default_rng(seed)
    if len(kinds) < LEAST:
        return np.nan, np.nan
    rows = {kind: np.flatnonzero(of == kind) for kind in kinds}
    values = [
        statistic(table.iloc[np.concatenate([rows[kind] for kind in rng.choice(kinds, len(kinds))])])
        for _ in range(draws)
    ]
    low, high = np.nanquantile(values, [0.025, 0.975]) if np.isfinite(values).any() else (np.nan, np.nan)
    return float(low), float(high)


def correlations(table: pd.DataFrame, draws: int = DRAWS) -> pd.DataFrame:
    """Rank correlation of each predictor with success: of arms that have a name, of the family, of all."""
    groups = {"arms with a name": table[~table.family], "family": table[table.family], "all": table}
    rows = []
    for name in present(table):
        row = {"predictor": name}
        for group, arms in groups.items():

            def statistic(some: pd.DataFrame, name: str = name) -> float:
                return rank_correlation(some[name].to_numpy(float), some.success.to_numpy(float))

            row[f"{group} (n = {len(arms)})"] = _text(statistic(arms), *interval(arms, statistic, draws))
        row["beyond the others, all"] = _text(partial_correlation(table, name), np.nan, np.nan)
        rows.append(row)
    return pd.DataFrame(rows)


def fit(table: pd.DataFrame) -> tuple[float, float]:
    """Intercept and slope of a logistic curve of success over the share that cannot be followed."""
    import statsmodels.api as sm

    x = sm.add_constant(table[FITTED].to_numpy(float), has_constant="add")
    counts = np.column_stack([table.success * table.n, (1 - table.success) * table.n])
    intercept, slope = map(float, sm.GLM(counts, x, family=sm.families.Binomial()).fit().params)
    return intercept, slope


def calibration(table: pd.DataFrame) -> pd.DataFrame | None:
    """Predicted and true success of the last third, by a curve of the first two; None where one of them is missing."""
    first, last = table[~table["last"]], table[table["last"]]
    if len(first) < LEAST or last.empty:
        return None
    guess = on_curve(fit(first), last[FITTED].to_numpy(float))
    return pd.DataFrame({"arm": last.name, "predicted": guess, "true": last.success, "off by": last.success - guess})


TEXT = """# Does similarity predict transfer?

Made by `python -m benchmark.studies.dose_response step=analyse`. Block push, direct transfer of {policies}, validation
scenes; {arms} arms. Before anything was played on the last third of them, `predictors.csv` was committed.

{defined}

## Ranks

Spearman's correlation with success, and its 95 % interval for other arms, in which the family counts as one. Beyond the
others: of what ranks of the other predictors leave open.

{ranks}

## Calibration

{calibration}

The j2s6s200 is the one that is far off. All the steps that it loses are too fast: its description lets its joints turn
by 0.63 and 0.84 rad/s (`python -m benchmark.check robot=j2s6s200`). The simulation lets the joints of every arm turn by
3.14 rad/s, as the xArm6's do, so there it is in time.

![success over each predictor](dose_response.png)

## Arms

{table}
"""


def page(table: pd.DataFrame, draws: int = DRAWS) -> str:
    """The page; arms are drawn anew that often for its intervals."""
    shown = table.sort_values(["family", "success"])[["name", "last", *present(table), "success", "n"]]
    shown = shown.round({name: 5 if name == "energy" else 3 for name in (*present(table), "success")})
    checked = calibration(table)
    if checked is None:
        said = "None yet: it takes arms of the first two thirds and of the last."
    else:
        error = np.abs(checked["off by"])
        said = (
            f"Success of the last third, predicted from `{FITTED}` by a logistic curve of the first two thirds, is off "
            f"by {error.mean():.3f} in the mean and {error.max():.3f} at most (mean with its sign "
            f"{checked['off by'].mean():+.3f}; n = {len(checked)} arms). Nine of ten other arms like these are "
            f"off by no more than {margin(checked['off by'].to_numpy()):.2f} (split conformal prediction), as "
            "`python -m benchmark.check` says.\n\n" + checked.round(3).to_markdown(index=False)
        )
    return TEXT.format(
        policies=f"{table.n.min()} to {table.n.max()} episodes per arm",
        arms=len(table),
        defined="\n".join(f"- `{name}`: {PREDICTORS[name]}" for name in present(table)),
        ranks=correlations(table, draws).to_markdown(index=False, disable_numparse=True),
        calibration=said,
        table=shown.to_markdown(index=False),
    )


def figure(table: pd.DataFrame) -> "Figure":
    """Success over each predictor."""
    from matplotlib.figure import Figure

    names = present(table)
    drawn = Figure(figsize=(3.4 * len(names), 3.2))
    for ax, name in zip(drawn.subplots(1, len(names), sharey=True, squeeze=False)[0], names, strict=True):
        for family, colour in ((False, "tab:blue"), (True, "tab:orange")):
            for last, filled in ((False, colour), (True, "none")):
                some = table[(table.family == family) & (table["last"] == last)]
                label = f"{'family' if family else 'with a name'}{', last third' if last else ''}"
                ax.scatter(some[name], some.success, s=26, facecolors=filled, edgecolors=colour, label=label)
        ax.set_xlabel(name)
        ax.set_ylim(-0.03, 1.03)
    drawn.axes[0].set_ylabel("success of direct transfer")
    drawn.axes[-1].legend(fontsize=7)
    return drawn


def _text(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return "-"
    return f"{value:.2f}" if np.isnan(low) else f"{value:.2f} [{low:.2f}, {high:.2f}]"
