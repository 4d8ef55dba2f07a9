"""A method of guidance that is not ours: a class in somebody's file."""

import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.rollouts.stranger import MOST_CHUNKS, ClassAttributes, Stranger
from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    import numpy as np
    from torch import Tensor

    from policies.guidance import Guidance


class GuidanceClass(Stranger):
    """A subclass of `policies.guidance.Guidance` in a file."""

    def make(
        self, scale: float, field: Path | None, base: tuple[float, float], seed: int, width: int = 2
    ) -> "Guidance":
        """An instance, called as `Class(field, scale, base, seed)` in a process of its own (`guest`).

        Args:
            scale: Its scale, `lambda`.
            field: File of the field that it asked for, which it is given loaded; None without one.
            base: Position of the arm's base, x and y in [m].
            seed: Of what is random.
            width: Numbers of the task's actions.

        Raises:
            SettingError: If the file does not have such a class. Likewise whatever is asked of the instance later,
                if it raises, answers what it should not, or takes too long or too much memory.
        """
        from benchmark.rollouts.guest import make_guest

        return make_guest(self, scale, field, base, seed, width)

    def attributes(self) -> ClassAttributes:
        """What the class says of itself.

        Raises:
            SettingError: If the file does not have such a class, or it says what cannot be.
        """
        from benchmark.rollouts.guest import class_attributes

        return class_attributes(self)

    def load(
        self, scale: float, field: Path | None, base: tuple[float, float], seed: int, width: int
    ) -> "tuple[Guidance, dict[str, Any]]":
        """An instance in this process, running the file, and what has to be known to ask it."""
        from policies.guidance import Guidance

        made: Callable[..., Guidance] = self.load_class()
        given = None
        if field:
            from richmap.similarity.load_field import load_field

            given = load_field(field)
        try:
            theirs = made(given, scale, base, seed)
        except BaseException as error:
            raise SettingError(f"{self.file}: {self.name}(field, scale, base, seed) {_raised(error)}") from error
        _check_places(theirs, f"{self.file}: {self.name}")
        checked = _checked(theirs, f"{self.file}: {self.name}", width)
        takes = [name for name in (*TOLD, *PLACES) if getattr(type(theirs), name) is not getattr(Guidance, name)]
        return checked, {"samples": theirs.samples, "looks_ahead": bool(theirs.looks_ahead), "takes": takes}

    def load_class(self) -> type:
        """The class in this process, running the file."""
        from policies.guidance import Guidance

        folder = str(self.file.parent.resolve())
        if folder not in sys.path:
            sys.path.append(folder)  # It may import what lies beside it.
        spec = importlib.util.spec_from_file_location(f"guidance_{self.file.stem}", self.file)
        assert spec and spec.loader
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # Dataclasses look their module up there.
        try:
            with _from_source():
                spec.loader.exec_module(module)
        except BaseException as error:
            raise SettingError(f"{self.file} {_raised(error)}") from error
        found = getattr(module, self.name, None)
        if not inspect.isclass(found) or not issubclass(found, Guidance):
            raise SettingError(f"{self.file} has no class {self.name} that is a policies.guidance.Guidance.")
        return found


TOLD = ("reset", "meet")
"""What a class is told."""
PLACES = ("imagine", "push", "descent", "choose", "correct")
"""Where it can act."""

OURS = ("noise", "weight", "settle", "settles", "repeats", "looks_at_noise")
"""What methods of ours have besides."""


def _raised(error: BaseException) -> str:
    return f"raised {type(error).__name__}: {error}".removesuffix(": ")


@contextmanager
def _from_source() -> Iterator[None]:
    """Imports compile the files that are there, which are hashed, and read no bytecode beside them."""
    before = sys.pycache_prefix
    with TemporaryDirectory() as empty:
        sys.pycache_prefix = empty
        try:
            yield
        finally:
            sys.pycache_prefix = before


def _check_places(theirs: "Guidance", where: str) -> None:
    """Raise `SettingError` if an instance has what would never be asked."""
    from policies.guidance import Guidance

    if not isinstance(theirs.samples, int) or not 1 <= theirs.samples <= MOST_CHUNKS:
        raise SettingError(f"{where}.samples is {theirs.samples!r}. It is a whole number from 1 to {MOST_CHUNKS}.")
    for name, asked, way_out in (
        ("descent", theirs.looks_ahead, "looks_ahead = True"),
        ("choose", theirs.samples > 1, "samples = 4, or another number above 1"),
    ):
        if not asked and getattr(type(theirs), name) is not getattr(Guidance, name):
            raise SettingError(f"{where}.{name} would never be asked. Give the class {way_out}.")

    for name in OURS:
        if name in vars(theirs) or getattr(type(theirs), name) is not getattr(Guidance, name):
            raise SettingError(
                f"{where}.{name} would never be asked: a class of a file runs in a process of its own, and is asked "
                f"once a chunk or a denoising step. Places to act: {', '.join(PLACES)}. A method that is declared in "
                "policies/methods.py has more: see docs/add-method.md."
            )


def _checked(theirs: "Guidance", where: str, width: int) -> "Guidance":
    """The same, but what it raises, and answers that are no finite tensors of the right shape, are said by name."""
    import torch

    from policies.guidance import Guidance

    def ask(name: str, shape: tuple[int, ...], *given: "Tensor", or_none: bool = False) -> "Tensor | None":
        try:
            answer = getattr(theirs, name)(*given)
        except BaseException as error:  # Whatever somebody's file may raise, also SystemExit.
            raise SettingError(f"{where}.{name} {_raised(error)}") from error
        if or_none and answer is None:
            return None
        if not isinstance(answer, torch.Tensor) or answer.shape != shape or not answer.isfinite().all():
            is_tensor = isinstance(answer, torch.Tensor)
            numbers = "" if is_tensor and answer.isfinite().all() else " with numbers that are not finite"
            found = f"a tensor {tuple(answer.shape)}{numbers}" if is_tensor else f"of type {type(answer).__name__}"
            raise SettingError(
                f"{where}.{name} gave what is {found}. It gives a tensor {shape} of finite numbers, also in rows of a "
                "batch that have no episode, whose state and scene are zeros."
            )
        return answer.to(given[0])

    def tell(name: str, *given: object) -> None:
        try:
            getattr(theirs, name)(*given)
        except BaseException as error:  # Likewise.
            raise SettingError(f"{where}.{name} {_raised(error)}") from error

    class Checked(Guidance):
        samples, looks_ahead = theirs.samples, theirs.looks_ahead

        def __init__(self) -> None:
            pass

        def reset(self, rows: "Sequence[int] | None") -> None:
            tell("reset", rows)

        def meet(self, rows: "Sequence[int]", places: "np.ndarray") -> None:
            tell("meet", rows, places)

        def imagine(self, environment: "Tensor", state: "Tensor") -> "Tensor":
            return ask("imagine", tuple(environment.shape), environment, state)

        def push(self, state: "Tensor") -> "Tensor | None":
            return ask("push", (len(state), width), state, or_none=True)

        def descent(self, actions: "Tensor", state: "Tensor") -> "Tensor":
            return ask("descent", tuple(actions.shape), actions, state)

        def choose(self, chunks: "Tensor", state: "Tensor") -> "Tensor":
            return ask("choose", (len(chunks), *chunks.shape[2:]), chunks, state)

        def correct(self, chunk: "Tensor", state: "Tensor") -> "Tensor":
            return ask("correct", tuple(chunk.shape), chunk, state)

    return Checked()
