"""What no command takes: numbers that would cost more than a machine has, empty lists, texts that can be no path."""

import math
import os
import resource
from collections.abc import Mapping
from typing import Any

from benchmark.settings.setting import Setting, SettingError, check_setting

GB = 1e9

WORKER_GB = 0.5
"""Memory of a process that rolls out or samples, in [GB]."""

EPISODE_SECONDS = 2
"""About what an episode on a UR3, where many last long, takes on one core."""

ENVIRONMENT_GB = 0.02
"""Memory of one environment, in [GB]."""

LARGEST_SEED = 2**63 - 1
MOST_EPISODES, MOST_ENVIRONMENTS, MOST_BATCH, MOST_LAMBDA = 1_000_000, 1000, 65_536, 10_000


def check_limits(values: Mapping[str, Any], settings: Mapping[str, Setting]) -> None:
    """Refuse what would only harm.

    Args:
        values: By the settings' names on the command line.
        settings: Of the command.

    Raises:
        SettingError: With what it would cost, where it is a cost.
    """
    for name, value in values.items():
        if isinstance(value, str):
            _check_text(name, value)
        elif isinstance(value, list) and name in settings:
            _check_list(name, value, settings[name].default)
            for each in value:
                if isinstance(each, str):
                    _check_text(name, each)
            for each in value if name in ("scale", "seeds") else []:
                _check_number(name, each, "")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            _check_number(name, value, "training " if "steps" in settings else "")


def _check_text(name: str, value: str) -> None:
    check_setting(value.isprintable(), name, repr(value), "a text of printed characters")
    home = value == "~" or value.startswith("~/")  # Shells replace it only where a word begins with it.
    check_setting(not home, name, value, f'a path in full, such as {name}="$HOME{value[1:]}"')


def _check_list(name: str, values: list, default: list | None) -> None:
    shown = f"[{','.join(map(str, values))}]"
    check_setting(bool(values) or not default, name, shown, "one value or more")
    if name not in COORDINATES:
        check_setting(len({*map(str, values)}) == len(values), name, shown, "each value once")


COORDINATES = (
    "arm.base", "arm.narrowed", "arm.posture", "base", "base.x", "base.y", "base.yaw", "base.z", "cell",
)  # fmt: skip
"""Lists in which a value may come twice."""


def _check_number(name: str, value: float, of: str) -> None:
    cores = os.cpu_count() or 1
    limits: dict[str, tuple[float, str]] = {
        "workers": (
            max(16, 4 * cores),
            f"processes of {WORKER_GB:g} GB each on {cores} cores: {value * WORKER_GB:,.0f} GB",
        ),
        "threads": (max(16, 4 * cores), f"threads on {cores} cores"),
        "batch_size": (
            MOST_ENVIRONMENTS,
            f"environments of {1000 * ENVIRONMENT_GB:g} MB: {value * ENVIRONMENT_GB:,.0f} GB",
        ),
        "episodes": (
            MOST_EPISODES,
            f"episodes of {EPISODE_SECONDS:g} s each: {value * EPISODE_SECONDS / 86400:,.0f} days",
        ),
        "training batch_size": (MOST_BATCH, f"rows at once: {value * 4e-5:,.0f} GB"),
        **dict.fromkeys(("seed", "seeds", "seed_start", "map.seed"), (LARGEST_SEED, "files hold 63 bits of it")),
        "lambda": (MOST_LAMBDA, "it is beyond every unit that a scale has"),
        "scale": (MOST_LAMBDA, "it is beyond every unit that a scale has"),
    }
    most, cost = limits.get(of + name) or limits.get(name, (math.inf, ""))
    if value > most:
        raise SettingError(f"{name}={value} is not allowed: {cost}. Allowed: up to {most}.")


def memory() -> float:
    """What a process may take of this machine's memory, in [GB]."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), resource.getrlimit(resource.RLIMIT_AS)[0]]
    return min(limit for limit in limits if limit > 0) / GB


def check_memory(name: str, value: Any, gigabytes: float) -> None:
    """Refuse what needs more memory than there is.

    Raises:
        SettingError: With both.
    """
    if not gigabytes <= memory():
        raise SettingError(
            f"{name}={value} is not allowed: it takes about {gigabytes:,.0f} GB of memory, and this machine has "
            f"{memory():,.0f}."
        )
