"""A method of guidance that is not ours: a class in somebody's file."""

import importlib.util
import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import SettingError

if TYPE_CHECKING:
    from policies.guidance import Guidance


@dataclass(frozen=True)
class GuidanceClass:
    """Where a subclass of `policies.guidance.Guidance` is."""

    file: Path
    name: str

    def make(self, scale: float, field: Path | None, base: tuple[float, float], seed: int) -> "Guidance":
        """An instance, called as `Class(field, scale, base, seed)`; running the file, so only what is trusted.

        Args:
            scale: Its scale, `lambda`.
            field: File of the field that it asked for, which it is given loaded; None without one.
            base: Position of the arm's base, x and y in [m].
            seed: Of what is random.

        Raises:
            SettingError: If the file does not have such a class.
        """
        from policies.guidance import Guidance
        from richmap.energy import EnergyField

        if not self.file.is_file():
            raise SettingError(f"There is no {self.file}, which should hold the guidance {self.name}.")
        spec = importlib.util.spec_from_file_location(f"guidance_{self.file.stem}", self.file)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        found = getattr(module, self.name, None)
        if not inspect.isclass(found) or not issubclass(found, Guidance):
            raise SettingError(f"{self.file} has no class {self.name} that is a policies.guidance.Guidance.")
        return found(EnergyField.load(field) if field else None, scale, base, seed)
