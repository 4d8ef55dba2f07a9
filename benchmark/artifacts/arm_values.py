"""The values of arms in the cache: what `benchmark.learn_value` learnt, one of each arm as it stands."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from rich.console import Console

    from envs.arm.placed_arm import PlacedArm
    from richmap.similarity.arm_value import ArmValue


def arm_key(arm: "PlacedArm") -> str:
    """SHA-256 over everything of an arm that an imagined episode depends on."""
    from richmap.cache import made_from
    from richmap.similarity.arm_value import ArmValue

    numbers = arm.numbers() | {"posture": arm.stored_posture}
    return made_from({"value": "press_buttons", **numbers}, ArmValue.VERSION)


def value_file(arm: "PlacedArm") -> Path:
    """Where an arm's value is in the cache, or would be."""
    import platformdirs

    folder = Path(platformdirs.user_cache_dir("richmap")) / "fields"
    return folder / f"value-{arm.robot}-{arm_key(arm)[:16]}.safetensors"


def arm_value(
    arm: "PlacedArm", _map: object, _energy: object, _workers: int, _console: "Console"
) -> "tuple[ArmValue, Path]":
    """What was learnt of how episodes end on an arm, and its file.

    Raises:
        SettingError: If nothing was, or the file is damaged or of another arm.
    """
    from richmap.outputs import FileRefusedError
    from richmap.similarity.arm_value import ArmValue

    file = value_file(arm)
    learn = (
        f"Learn one, which takes minutes: python -m benchmark.learn_value task=press_buttons robot={arm.robot}, with "
        "the same setting= and arm.* as here"
    )
    try:
        value = ArmValue.load(file)
    except FileNotFoundError as error:
        raise SettingError(f"There is no value of {arm.robot} as it stands here. {learn}.") from error
    except FileRefusedError as error:
        raise SettingError(f"{error} {learn}.") from error
    if value.about["arm"] != arm_key(arm):
        raise SettingError(f"{file} is of {value.about['target']}, or of an arm that stands otherwise. {learn}.")
    return value, file
