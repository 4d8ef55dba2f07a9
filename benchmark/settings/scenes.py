"""Which scenes are for what, by the seeds that they are drawn from; `docs/protocol.md` says it in words."""

from benchmark.settings.setting import SettingError, check_setting

VALIDATION = range(50_000, 60_000)
"""For every choice: of conditions, bases, scales, versions of methods."""
IMAGINED = range(60_000, 100_000)
"""Of imagined episodes, from which values of arms are learnt: nothing is rolled out on them."""
PAPER = range(100_000, 100_050)
"""The paper's, which were looked at often: what is shown on them is called exploratory."""
TABLES = range(150_000, 150_100)
"""Of published tables, by rows whose commit is later than all choices."""
RANKING = range(160_000, 160_100)
"""Of the ranking of all methods, `suite=full`, and of nothing else."""
RANKED = "full"
"""The suite of these."""

FIRST_TEST_SEED = PAPER.start
"""Scenes from here on are for final figures, and nothing is chosen by them."""


def check_scenes(first: int, count: int, suite: str = "") -> None:
    """Raise `SettingError` for seeds that no scene can be drawn from, and for scenes that another suite has to itself.

    NumPy's legacy generator, which draws the scenes, takes 32-bit seeds.
    """
    check_setting(0 <= first <= 2**32 - count, "seed_start", first, "a whole number from 0 to 2^32 - episodes")
    if first < FIRST_TEST_SEED < first + count:
        raise SettingError(
            f"seed_start={first} with episodes={count} is not allowed: scenes from {FIRST_TEST_SEED} on are for final "
            "figures alone. Take scenes on one side of it."
        )
    if first < RANKING.stop and first + count > RANKING.start and suite != RANKED:
        raise SettingError(
            f"seed_start={first} with episodes={count} is not allowed: scenes {RANKING[0]} to {RANKING[-1]} are those "
            f"of suite={RANKED} alone. Allowed: {VALIDATION[0]} to {VALIDATION[-1]} to choose by, {TABLES[0]} to "
            f"{TABLES[-1]} for tables."
        )
