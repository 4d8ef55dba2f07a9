"""How long methods take to decide, as it was measured (`benchmark.studies.decision_time`)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.setting import SettingError
from policies.methods import in_task

if TYPE_CHECKING:
    import pandas as pd

FILE = Path("results/decision_times.csv")
"""A row for each task, method and scale: time of the processor per control step, mean and longest, in [ms]."""
KEY = ["task", "method", "lambda"]


def with_times(ranking: "pd.DataFrame", file: Path = FILE) -> "pd.DataFrame":
    """A ranking of methods with a column `step_ms`, the mean per control step, of several tasks the longest; NaN where
    it is not known.

    Raises:
        SettingError: If the file is damaged.
    """
    import pandas as pd

    if ranking.empty or not file.is_file():
        return ranking.assign(step_ms=np.nan)
    try:
        known = pd.read_csv(file).set_index(KEY).mean_ms.astype(float)
    except (ValueError, KeyError, AttributeError) as error:
        raise SettingError(
            f"{file} holds no decision times ({error!r:.200}). Remove it, or measure anew: "
            "python -m benchmark.studies.decision_time"
        ) from error
    times = (
        [known.get((task, in_task(row.method, task), scale), np.nan) for task, scale in row.scales.items()]
        for _, row in ranking.iterrows()
    )
    return ranking.assign(step_ms=[max(each) if np.isfinite(each).all() else np.nan for each in times])
