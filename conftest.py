"""Python blocks of the documents, as tests: `make test-docs`. Blocks of one page share their names.

They run in a folder of their own, which holds what the shell blocks beside them need or make: they leave no row,
map or data set in the project's.
"""

import os
import tempfile
from functools import cache
from pathlib import Path

from sybil import Sybil
from sybil.parsers.myst import PythonCodeBlockParser, SkipParser

ROOT = Path(__file__).parent

ARM = """<robot name="arm">
  <link name="base_link"/>
  <joint name="shoulder" type="revolute"><parent link="base_link"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="upper"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="tool0"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="tool0"/>
</robot>
"""


@cache
def _folder() -> Path:
    from benchmark.training.collection import collect
    from benchmark.training.demonstration_recipe import CollectConfig

    folder = Path(tempfile.mkdtemp(prefix="documents-"))
    (folder / "results").mkdir()
    for published in (ROOT / "results").iterdir():
        if published.name != "episodes":
            (folder / "results" / published.name).symlink_to(published)
    (folder / "arm.urdf").write_text(ARM)
    collect(CollectConfig(episodes=1, workers=1, output_dir=str(folder / "demonstrations" / "d40")))
    return folder


pytest_collect_file = Sybil(
    parsers=[PythonCodeBlockParser(), SkipParser()],
    patterns=["README.md", "docs/*.md"],
    setup=lambda names: os.chdir(_folder()),
    teardown=lambda names: os.chdir(ROOT),
).pytest()
