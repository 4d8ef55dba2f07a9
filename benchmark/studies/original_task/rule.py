"""By which rule the base and lambda are taken, and what is predicted: written down before anything was rolled out.

Scores are the paper's: 0.49 for some block in a target and 1 for both, in percent, over the 50 scenes that it used.

- Base: of the x of the first stage, that whose direct scores of UR3, UR5 and UR10 differ least from the paper's, summed
  over the arms; the smallest of equal ones. Guided scores have no say.
- Lambda: of the ten of the second stage, for each arm the one with the best score over the nine policies; the smallest
  of equal ones. The paper seems to have chosen so, on the scenes that it reports. Beside it stands what is left when
  lambda is chosen on two training seeds and scored on the third.
- Prediction, of the first stage: one and the same x gives direct UR3 60 to 75, UR5 93 or more, UR10 70 to 80, and UR3
  88 or more at the better of lambda 0.5 and 1. It is refuted if no x does.
"""

import pandas as pd

PAPER = {"ur3": (64.64, 91.34), "ur5": (95.15, 94.60), "ur10": (75.96, 82.72)}
"""The paper's table: direct and guided, in percent."""
FIRST_X = (0.0, 0.04, 0.05, 0.06, 0.07)
"""Bases of the first stage: how far nearer to the table than the xArm6's, in [m]."""
FIRST_LAMBDAS = (0.0, 0.5, 1.0)
LAMBDAS = tuple(i / 10 for i in range(11))
"""Of the second stage."""
PREDICTED = {"ur3": (60.0, 75.0), "ur5": (93.0, 100.0), "ur10": (70.0, 80.0)}
"""Direct, least and most, in percent."""
PREDICTED_GUIDED_UR3 = 88.0
"""Least, in percent."""


def scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean scores in percent, by base x (rows) and by arm and lambda (columns): each policy counts the same."""
    policies = rows.groupby(["base_x", "robot", "lambda", "checkpoint_hash"]).score.mean()
    return 100 * policies.groupby(["base_x", "robot", "lambda"]).mean().unstack(["robot", "lambda"])


def distance(table: pd.DataFrame) -> pd.Series:
    """By base x, how far direct scores are from the paper's, summed over the arms, in percentage points."""
    return sum((table[arm, 0.0] - direct).abs() for arm, (direct, _) in PAPER.items())


def chosen_x(rows: pd.DataFrame) -> float:
    """The base that the rule takes, in [m]."""
    away = distance(scores(rows)).round(9)
    return float(away.sort_index().idxmin())


def chosen_lambda(rows: pd.DataFrame, arm: str) -> float:
    """The lambda that the rule takes for an arm, of those above 0."""
    of_arm = rows[(rows.robot == arm) & (rows["lambda"] > 0)]
    policies = of_arm.groupby(["lambda", "checkpoint_hash"]).score.mean()
    return float(policies.groupby("lambda").mean().round(9).sort_index().idxmax())


def held_out_score(rows: pd.DataFrame, arm: str) -> float:
    """Score of an arm in percent when lambda is chosen on the other training seeds, and each seed is scored so."""
    of_arm = rows[rows.robot == arm]
    scored = []
    for seed in sorted(of_arm.training_seed.unique()):
        apart = of_arm.training_seed == seed
        best = chosen_lambda(of_arm[~apart], arm)
        scored.append(of_arm[apart & (of_arm["lambda"] == best)].score.mean())
    return 100 * sum(scored) / len(scored)


def as_predicted(rows: pd.DataFrame) -> list[float]:
    """Bases at which everything is as predicted, in [m]; none refutes the prediction."""
    table = scores(rows)
    holds = table["ur3"][[0.5, 1.0]].max(axis=1) >= PREDICTED_GUIDED_UR3
    for arm, (least, most) in PREDICTED.items():
        holds &= table[arm, 0.0].between(least, most)
    return [float(x) for x in table.index[holds]]


def in_words(rows: pd.DataFrame) -> str:
    """What the rule takes of the rows, and whether it came out as predicted, as far as stages are complete."""
    first = scores(rows[rows["lambda"].isin(FIRST_LAMBDAS) & rows.base_x.isin(FIRST_X)])
    asked = pd.MultiIndex.from_product([PAPER, FIRST_LAMBDAS])
    if first.reindex(index=FIRST_X, columns=asked).isna().any(axis=None):
        return "The first stage is not complete, so no base is taken."
    x, away, holds = chosen_x(rows), distance(first), as_predicted(rows[rows["lambda"].isin(FIRST_LAMBDAS)])
    said = [f"x = {at:g} m: {points:.1f}" for at, points in away.items()]
    lines = [
        f"Points from the paper's direct scores, summed over the arms: {', '.join(said)}. The rule takes x = {x:g} m.",
        f"As predicted at x = {', '.join(f'{each:g}' for each in holds)} m." if holds else "As predicted at no base.",
    ]
    second = rows[rows.base_x == x]
    for arm in PAPER:
        if {*LAMBDAS} <= {*second["lambda"][second.robot == arm].round(9)}:
            best, apart = chosen_lambda(second, arm), held_out_score(second, arm)
            lines.append(f"{arm}: lambda {best:g}; chosen on two trainings and scored on the third, {apart:.1f}.")
    return "\n".join(lines)
