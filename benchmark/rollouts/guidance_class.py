"""A method of guidance that is not ours: a class in somebody's file."""

import importlib.util
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

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
        folder = self.file.parent.resolve()
        if not any(isinstance(hook, _FinderBelow) and hook.folder == folder for hook in sys.path_hooks):
            sys.path_hooks.insert(0, _FinderBelow(folder))
            sys.path_importer_cache.clear()  # Of finders that were there before, for folders of the entry.
            sys.path.append(str(folder))  # It may import what lies beside it.
        loader = _FromSource(f"guidance_{self.file.stem}", str(self.file))
        spec = importlib.util.spec_from_loader(loader.name, loader)
        assert spec
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # Dataclasses look their module up there.
        loader.exec_module(module)
        found = getattr(module, self.name, None)
        if not inspect.isclass(found) or not issubclass(found, Guidance):
            raise SettingError(f"{self.file} has no class {self.name} that is a policies.guidance.Guidance.")
        made: Callable[..., Guidance] = found
        theirs = made(load_field(field) if field else None, scale, base, seed)
        return _checked(theirs, f"{self.file}: {self.name}", width)


class _FromSource(SourceFileLoader):
    """Compiles an entry's files, which are hashed: Python's own beside them are not, and may hold other code."""

    def path_stats(self, path: str) -> NoReturn:
        """Without which Python neither reads such a file nor writes one."""
        raise OSError(f"{path} is always compiled.")


@dataclass(frozen=True)
class _FinderBelow:
    """A path hook by which modules in a folder and below it are found by their source alone."""

    folder: Path

    def __call__(self, path: str) -> FileFinder:
        if not Path(path).resolve().is_relative_to(self.folder):
            raise ImportError(f"{path} is no folder of the entry.")
        return FileFinder(path, (_FromSource, SOURCE_SUFFIXES))


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
