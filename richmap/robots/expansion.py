"""Xacro files, expanded without ROS, in a process of its own: their expressions are Python, and may not end."""

import ast
import json
import os
import re
import resource
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from richmap.robots.packages import is_nameless, package_folders

LONGEST, LARGEST = 30, 2 * 2**30
"""What an expansion may take, in seconds and bytes. Vendors' files take a second or two, and a tenth of a gigabyte."""
MOST_TEXT = 100_000_000
"""Characters of an expanded file."""


def expanded(file: Path, arguments: str = "") -> ET.Element:
    """A xacro file with its macros expanded; `$(find package)` as in `package_folders`.

    Args:
        file: The file.
        arguments: Its arguments, as in `name:=ur5e prefix:=left_`.

    Raises:
        ValueError: If that cannot be done, or takes more than 30 s or 2 GiB.
    """
    command = [sys.executable, "-P", "-X", "utf8", "-m", __name__, str(file), arguments]
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        ended = subprocess.run(
            command,
            env=os.environ | found,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            timeout=LONGEST,
            process_group=0,  # Ctrl-C is for us.
        )
        code = ended.returncode
        said = {"error": f"its process ended with {code}"} if code else json.loads(ended.stdout)
    except subprocess.TimeoutExpired:
        said = {"error": f"its expressions take more than {LONGEST} s"}
    if "error" in said:
        given = 'Arguments are given as in arguments="name:=value other:=value"'
        raise ValueError(f"{file} cannot be expanded: {said['error']}. {given}")
    return ET.fromstring(said["xml"])


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


def _expand(file: Path, arguments: str) -> dict[str, str]:
    """Text of the expanded file, or why it cannot be expanded."""
    import xacro

    given = None
    try:
        given = _Arguments(arguments)
        _teach(file)
        text = xacro.process_file(str(file), mappings=given).toxml()
        if len(text) > MOST_TEXT:
            raise ValueError(f"it becomes {len(text):,} characters, and {MOST_TEXT:,} are the most")
        if unknown := sorted(given.given - given.asked):
            known = ", ".join(sorted(map(str, given.asked))) or "none"
            raise ValueError(f"it has no argument {unknown[0]!r}. Its arguments: {known}")
        if left := [each.tag.rpartition("}")[2] for each in ET.fromstring(text).iter() if "xacro}" in each.tag]:
            raise ValueError(f"macros have the prefix xacro:, and {', '.join(sorted({*left}))} has another")
        return {"xml": text}
    except Exception as error:  # Expressions of the file raise what they raise.
        why = " ".join(str(error).split()) or type(error).__name__
        idle = sorted(given.given - given.asked) if given else []
        why += f"; until then it did not ask for {', '.join(idle)}" if idle and idle[0] not in why else ""
        return {"error": why}


REFUSED = (ast.Lambda, ast.GeneratorExp, ast.NamedExpr, ast.Await, ast.Yield, ast.YieldFrom)
"""Parts of Python from which an expression gets at the interpreter's own objects."""
INNER = re.compile(r"_|(gi|cr|ag|tb)_(frame|code|next|await|yieldfrom)$|f_(back|builtins|code|globals|locals)$|mro$")
"""Names of attributes that do so, too."""


def _check_expression(expression: str) -> None:
    """Refuse an expression of a xacro file that reaches for Python's inner names.

    Raises:
        ValueError: If it does.
    """
    if "__" in expression:
        raise ValueError(f"expression {expression:.200} has two underscores on end, which are not evaluated")
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        if isinstance(node, REFUSED) or (isinstance(node, ast.Attribute) and INNER.match(node.attr)):
            raise ValueError(f"expression {expression:.200} has {ast.unparse(node):.100}, which is not evaluated")


def _teach(file: Path) -> None:
    """From now on xacro finds packages, and evaluates no expression that reaches for Python's inner names."""
    import xacro

    def get_package_share_directory(name: str) -> str:
        beside_urdf = (folder for folder in file.parents if (folder / "urdf").is_dir())  # a copy under another name
        for folder in (*package_folders(name, file), *(beside_urdf if is_nameless(file) else ())):
            return str(folder)
        raise ValueError(f"there is no package {name!r} in the folders above it, AMENT_PREFIX_PATH or ROS_PACKAGE_PATH")

    def evaluate(expression: str, *names: dict) -> object:
        _check_expression(expression)
        try:
            return safe_eval(expression, *names)
        except MemoryError as error:
            raise ValueError(f"it takes more than {LARGEST / 2**30:g} GiB of memory") from error

    def get_include_files(name: str, symbols: object) -> Iterator[str]:
        for included in include_files(name, symbols):
            if os.path.exists(included) and not os.path.isfile(included):  # To open a pipe would wait for its writer.
                raise ValueError(f"it includes {included}, which is no file")
            yield included

    packages = ModuleType("ament_index_python.packages")
    packages.__dict__["get_package_share_directory"] = get_package_share_directory
    sys.modules |= {"ament_index_python": ModuleType("ament_index_python"), "ament_index_python.packages": packages}
    safe_eval, include_files = xacro.safe_eval, xacro.get_include_files
    xacro.safe_eval, xacro.get_include_files = evaluate, get_include_files


if __name__ == "__main__":
    for kind, most in ((resource.RLIMIT_AS, LARGEST), (resource.RLIMIT_CPU, LONGEST)):  # Also if nobody waits any more.
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    json.dump(_expand(Path(sys.argv[1]), sys.argv[2]), sys.stdout)
