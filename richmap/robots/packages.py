"""Files that a description names: by path, as `file://` or as `package://`; and xacro, expanded without ROS."""

import ast
import os
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote

NAMED = ("package://", "model://")
"""What begins the name of a file in a package."""


def package_folders(name: str, file: Path) -> Iterator[Path]:
    """Folders of a ROS package, the likeliest first.

    A folder is the package if it is called so or its `package.xml` says so. Those above the file and those beside them
    come first, then what `AMENT_PREFIX_PATH` and `ROS_PACKAGE_PATH` hold.

    Args:
        name: Of the package.
        file: The description that names it.
    """
    for folder in file.parents:
        if folder.name == name or _named(folder) == name:
            yield folder
        if (folder / name).is_dir():
            yield folder / name
        yield from (about.parent for about in sorted(folder.glob("*/package.xml")) if _named(about.parent) == name)
    for prefix in _paths("AMENT_PREFIX_PATH"):
        if (prefix / "share" / name).is_dir():
            yield prefix / "share" / name
    for root in _paths("ROS_PACKAGE_PATH"):
        folders = [root, *(about.parent for about in sorted(root.rglob("package.xml")))]
        yield from (folder for folder in folders if folder.name == name or _named(folder) == name)


def _paths(variable: str) -> list[Path]:
    return [Path(path) for path in os.environ.get(variable, "").split(os.pathsep) if path]


def _named(folder: Path) -> str | None:
    """What a folder's `package.xml` calls the package."""
    try:
        return (ET.parse(folder / "package.xml").getroot().findtext("name") or "").strip() or None
    except (OSError, ET.ParseError):
        return None


def named_file(name: str, file: Path) -> Path:
    """The file that a description names.

    Raises:
        ValueError: If there is none; says where it was looked for.
    """
    hint, first = "", None
    for found in _named_files(name, file):
        first = first or found
        for each in (found, Path(unquote(str(found)))):
            if each.is_file():
                return each.resolve()
    if name.startswith(NAMED):
        package = name.partition("://")[2].partition("/")[0]
        hint = (
            f" Package {package!r} is looked for in the folders above {file} and beside those, by its package.xml too, "
            "then in AMENT_PREFIX_PATH and ROS_PACKAGE_PATH."
        )
        if first is None:
            raise ValueError(f"there is no package {package!r}.{hint}")
    raise ValueError(f"there is no file {first}.{hint}")


def _named_files(name: str, file: Path) -> Iterator[Path]:
    """Where a file may be that a description names, the likeliest place first."""
    if not name.startswith(NAMED):
        yield file.parent / name.removeprefix("file://localhost").removeprefix("file://")
        return
    package, _, inside = name.partition("://")[2].partition("/")
    folder = None
    for folder in package_folders(package, file):
        yield folder / inside
    if folder is None and _is_nameless(file):  # A copy under another name, perhaps.
        yield from (each / inside for each in file.parents if (each / inside).is_file())


def _is_nameless(file: Path) -> bool:
    """Whether no `package.xml` says which package a file is of."""
    return not any(map(_named, file.parents))


class _Arguments(dict[str, str]):
    """Arguments of a xacro file, which remember what was asked for."""

    def __init__(self, text: str) -> None:
        for said in text.split():
            name, given, value = said.partition(":=")
            if not (name and given):
                raise ValueError(f"argument {said!r} is not name:=value")
            self[name] = value
        self.given, self.asked = {*self}, set[object]()

    def __contains__(self, name: object) -> bool:
        self.asked.add(name)
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


def expanded(file: Path, arguments: str = "") -> ET.Element:
    """A xacro file with its macros expanded; `$(find package)` as in `package_folders`.

    Args:
        file: The file.
        arguments: Its arguments, as in `name:=ur5e prefix:=left_`.

    Raises:
        ValueError: If that cannot be done.
    """
    import xacro

    given = None
    try:
        given = _Arguments(arguments)
        with _finding(file):
            root = ET.fromstring(xacro.process_file(str(file), mappings=given).toxml())
        if unknown := sorted(given.given - given.asked):
            known = ", ".join(sorted(map(str, given.asked))) or "none"
            raise ValueError(f"it has no argument {unknown[0]!r}. Its arguments: {known}")
        if left := [each.tag.rpartition("}")[2] for each in root.iter() if "xacro}" in each.tag]:
            raise ValueError(f"macros have the prefix xacro:, and {', '.join(sorted({*left}))} has another")
        return root
    except Exception as error:  # Expressions of the file raise what they raise.
        why = " ".join(str(error).split()) or type(error).__name__
        idle = sorted(given.given - given.asked) if given else []
        why += f"; until then it did not ask for {', '.join(idle)}" if idle and idle[0] not in why else ""
        raise ValueError(
            f'{file} cannot be expanded: {why}. Arguments are given as in arguments="name:=value other:=value"'
        ) from error


REFUSED = (ast.Lambda, ast.GeneratorExp, ast.NamedExpr, ast.Await, ast.Yield, ast.YieldFrom)
"""Parts of Python from which an expression gets at the interpreter's own objects."""
INNER = re.compile(r"_|(gi|cr|ag|tb)_(frame|code|next|await|yieldfrom)$|f_(back|builtins|code|globals|locals)$|mro$")
"""Names of attributes that do so, too."""
MOST_REPEATED, HIGHEST_POWER = 1_000_000, 64


def _check_expression(expression: str) -> None:
    """Refuse an expression of a xacro file that reaches for Python's inner names, or makes something huge.

    Raises:
        ValueError: If it does.
    """
    if "__" in expression:
        raise ValueError(f"expression {expression:.200} has two underscores on end, which are not evaluated")
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        if isinstance(node, REFUSED) or (isinstance(node, ast.Attribute) and INNER.match(node.attr)):
            raise ValueError(f"expression {expression:.200} has {ast.unparse(node):.100}, which is not evaluated")
        if not isinstance(node, ast.BinOp):
            continue
        sides = (node.left, node.right)
        constants = [each.value for each in sides if isinstance(each, ast.Constant)]
        numbers = [each for each in constants if isinstance(each, int | float)]
        power, least = isinstance(node.op, ast.Pow), HIGHEST_POWER if isinstance(node.op, ast.Pow) else MOST_REPEATED
        nested = power and any(isinstance(each, ast.BinOp) for each in sides)
        sequence = any(isinstance(each, ast.List | ast.Tuple | ast.JoinedStr) for each in sides)
        sequence |= any(isinstance(each, str) for each in constants)
        repeats = isinstance(node.op, ast.Mult) and sequence
        if nested or ((power or repeats) and any(abs(each) > least for each in numbers)):
            raise ValueError(f"expression {expression:.200} may be huge, and is not evaluated")


@contextmanager
def _finding(file: Path) -> Iterator[None]:
    """Within it, xacro finds packages, and evaluates no expression that reaches for Python's inner names."""
    import xacro

    def get_package_share_directory(name: str) -> str:
        beside_urdf = (folder for folder in file.parents if (folder / "urdf").is_dir())  # a copy under another name
        for folder in (*package_folders(name, file), *(beside_urdf if _is_nameless(file) else ())):
            return str(folder)
        raise ValueError(f"there is no package {name!r} in the folders above it, AMENT_PREFIX_PATH or ROS_PACKAGE_PATH")

    def evaluate(expression: str, *names: dict) -> object:
        _check_expression(expression)
        return safe_eval(expression, *names)

    def get_include_files(name: str, symbols: object) -> Iterator[str]:
        for included in include_files(name, symbols):
            if os.path.exists(included) and not os.path.isfile(included):  # To open a pipe would wait for its writer.
                raise ValueError(f"it includes {included}, which is no file")
            yield included

    packages = ModuleType("ament_index_python.packages")
    packages.__dict__["get_package_share_directory"] = get_package_share_directory
    ours = {"ament_index_python": ModuleType("ament_index_python"), "ament_index_python.packages": packages}
    before, safe_eval = {name: sys.modules.get(name) for name in ours}, xacro.safe_eval
    include_files = xacro.get_include_files
    sys.modules.update(ours)
    xacro.safe_eval, xacro.get_include_files = evaluate, get_include_files
    try:
        yield
    finally:
        xacro.safe_eval, xacro.get_include_files = safe_eval, include_files
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
