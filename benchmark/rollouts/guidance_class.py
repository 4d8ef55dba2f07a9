"""A method of guidance that is not ours: a class in somebody's file."""

import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.settings.command import SettingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from policies.guidance import Guidance


@dataclass(frozen=True)
class GuidanceClass:
    """Where a subclass of `policies.guidance.Guidance` is."""

    file: Path
    name: str

    def make(
        self, scale: float, field: Path | None, base: tuple[float, float], seed: int, width: int = 2
    ) -> "Guidance":
        """An instance, called as `Class(field, scale, base, seed)`; running the file, so only what is trusted.

        Args:
            scale: Its scale, `lambda`.
            field: File of the field that it asked for, which it is given loaded; None without one.
            base: Position of the arm's base, x and y in [m].
            seed: Of what is random.
            width: Numbers of the task's actions.

        Raises:
            SettingError: If the file does not have such a class. Likewise whatever is asked of the instance later,
                if it raises, or answers what it should not.
        """
        from policies.guidance import Guidance
        from richmap.similarity.load_field import load_field

        if not self.file.is_file():
            raise SettingError(f"There is no {self.file}, which should hold the guidance {self.name}.")
        folder = str(self.file.parent.resolve())
        if folder not in sys.path:
            sys.path.append(folder)  # It may import what lies beside it.
        spec = importlib.util.spec_from_file_location(f"guidance_{self.file.stem}", self.file)
        assert spec and spec.loader
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # Dataclasses look their module up there.
        with _from_source():
            spec.loader.exec_module(module)
        found = getattr(module, self.name, None)
        if not inspect.isclass(found) or not issubclass(found, Guidance):
            raise SettingError(f"{self.file} has no class {self.name} that is a policies.guidance.Guidance.")
        made: Callable[..., Guidance] = found
        theirs = made(load_field(field) if field else None, scale, base, seed)
        return _checked(theirs, f"{self.file}: {self.name}", width)


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


def _checked(theirs: "Guidance", where: str, width: int) -> "Guidance":
    """The same, but what it raises, and answers that are no finite tensors of the right shape, are said by name."""
    import torch

    from policies.guidance import Guidance

    if not isinstance(theirs.samples, int) or theirs.samples < 1:
        raise SettingError(f"{where}.samples is {theirs.samples!r}. It is a whole number >= 1.")
    for name, asked, way_out in (
        ("descent", theirs.looks_ahead, "looks_ahead = True"),
        ("choose", theirs.samples > 1, "samples = 4, or another number above 1"),
    ):
        if not asked and getattr(type(theirs), name) is not getattr(Guidance, name):
            raise SettingError(f"{where}.{name} would never be asked. Give the class {way_out}.")

    def ask(name: str, shape: tuple[int, ...], *given: "Tensor", or_none: bool = False) -> "Tensor | None":
        try:
            answer = getattr(theirs, name)(*given)
        except Exception as error:  # Whatever somebody's file may raise.
            raise SettingError(f"{where}.{name} raised {type(error).__name__}: {error}") from error
        if or_none and answer is None:
            return None
        if not isinstance(answer, torch.Tensor) or answer.shape != shape or not answer.isfinite().all():
            is_tensor = isinstance(answer, torch.Tensor)
            found = f"a tensor {tuple(answer.shape)}" if is_tensor else f"of type {type(answer).__name__}"
            raise SettingError(
                f"{where}.{name} gave what is {found}. It gives a tensor {shape} of finite numbers, also in rows of a "
                "batch that have no episode, whose state and scene are zeros."
            )
        return answer.to(given[0])

    class Checked(Guidance):
        samples, looks_ahead = theirs.samples, theirs.looks_ahead

        def __init__(self) -> None:
            pass

        def reset(self, rows: "Sequence[int] | None") -> None:
            try:
                theirs.reset(rows)
            except Exception as error:  # Whatever somebody's file may raise.
                raise SettingError(f"{where}.reset raised {type(error).__name__}: {error}") from error

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
