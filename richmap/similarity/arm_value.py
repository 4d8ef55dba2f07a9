"""What was learnt of how episodes end on one arm: the weights of a network, kept beside the fields."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, final

import numpy as np

from richmap.files import reading, save_arrays


@final
@dataclass(frozen=True)
class ArmValue:
    """Weights of a network, and what they were learnt from; `policies.press_buttons.value` makes the network of them.

    It has no cells: what it looks at are moments of an episode, not places.
    """

    weights: dict[str, np.ndarray]
    """By the names of the network's parameters, in float32."""
    about: dict[str, str]
    """What it was learnt from: `target`, the arm's name; `arm`, a hash of the arm as it stands; `fingerprint`, a hash
    of that and of all settings."""

    KIND: ClassVar[str] = "richmap.ArmValue"
    """What its files call themselves."""
    VERSION: ClassVar[int] = 1
    """Of the files' format, of what the network sees and of its layers."""
    grid: ClassVar[None] = None

    def save(self, path: Path | str) -> None:
        """Write it as one safetensors file, atomically."""
        save_arrays(Path(path), self.KIND, self.VERSION, self.weights, self.about)

    @classmethod
    def load(cls, path: Path | str) -> "ArmValue":
        """Read one.

        Raises:
            FileRefusedError: If the file is cut short or damaged, is of another kind, or has another version.
        """
        with reading(path, cls.KIND, cls.VERSION) as (arrays, about):
            return cls({name: array.copy() for name, array in arrays.items()}, about)
