"""With what settings the maps and the field of stored episodes were made, in the folder `fields` beside their table.

A row of the table has the field's fingerprint, which these settings give again, or else they are not the ones.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.fields import MAPS
from benchmark.settings.config import RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import SOURCE
from benchmark.settings.setting import SettingError
from richmap.given_files import given_json
from richmap.outputs import replacing

if TYPE_CHECKING:
    from benchmark.rollouts.players import Player

VERSION = 1
"""Of the file's format."""


def note_settings(output_dir: Path, players: "Sequence[Player]", config: RunConfig) -> None:
    """Write `fields/<fingerprint>.json` for each field of some players that is made of maps, if it is not there."""
    for player in players:
        condition = player.condition
        file = output_dir / _name(condition.field_fingerprint)
        if player.kind not in MAPS or file.exists():
            continue
        about = {"source": SOURCE, "target": condition.robot, "fingerprint": condition.field_fingerprint}
        settings = {"map": config.map.construction, "energy": asdict(config.energy)}
        with replacing(file) as path:
            path.write_text(json.dumps({"version": VERSION} | about | settings, indent=1) + "\n")


def noted_settings(table: Path, fingerprint: str) -> tuple[MapConfig, EnergyConfig] | None:
    """The settings of a field's maps and its own, beside a table or anywhere in a folder of tables; None if not there.

    Raises:
        SettingError: If the file is damaged, or of another version.
    """
    if not re.fullmatch("[0-9a-f]{16,}", fingerprint):
        return None
    name = _name(fingerprint)
    beside = table.resolve().parent.parent / name  # A part lies in the folder `episodes` of its table.
    files = sorted(table.rglob(str(name))) if table.is_dir() else [beside] * beside.exists()
    if not files:
        return None
    try:
        noted = given_json(files[0])
        if noted["version"] == VERSION:
            return MapConfig(**noted["map"]), EnergyConfig(**noted["energy"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise SettingError(f"{files[0]} is damaged ({error!r:.200}). Remove it; give map.* and energy.*.") from error
    raise SettingError(f"{files[0]} is of version {noted['version']}, not {VERSION}. Give map.* and energy.*.")


def _name(fingerprint: str) -> Path:
    return Path("fields") / f"{fingerprint[:16]}.json"
