import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

from benchmark import cache
from benchmark.code_version import PACKAGES, ROOT, code_version, deciding_files

LOADED = """
import sys
from pathlib import Path
from rich.console import Console
from benchmark.config import RobotConfig, RunConfig
from benchmark.rollout import play
from benchmark.known_policies import checkpoint_folder
from benchmark.make_rollout import make_rollout

config = RunConfig(robot=RobotConfig("ur3"), method="projection", slots=1, device="cpu")
rollout = make_rollout(config, 0.01, checkpoint_folder(42), Console(quiet=True))
play(rollout, [50_001])
print(*{module.__file__ for module in list(sys.modules.values()) if getattr(module, "__file__", None)}, sep="\\n")
"""
MAKES_MAPS = {
    "similarity", "reachability_map", "checked_poses", "direction_index", "directions", "insertion", "sampling",
    "ground", "torch_twin", "direction_blocks", "roll",
}  # fmt: skip
"""Modules that a field's maker imports; the fingerprint of the field, which is a column, stands for what they do."""


def test_whatever_a_guided_episode_loads_of_ours_decides_it():
    run = subprocess.run([sys.executable, "-c", LOADED], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {Path(line) for line in run.stdout.splitlines()}
    ours = {file for file in loaded if file.parent in [ROOT / name for name in ("richmap", "envs", "policies")]}
    missing = {file.stem for file in ours - {*deciding_files()}}
    assert missing <= MAKES_MAPS and len(ours) > 30


def test_the_version_is_of_content_and_includes_collision_geometry_but_no_verification():
    names = {file.relative_to(ROOT).as_posix() for file in deciding_files()}
    assert {
        "benchmark/rollout.py",
        "benchmark/arm_oracle.py",
        "envs/block_push.py",
        "policies/guidance.py",
        "richmap/collision.py",
    } <= names
    assert any(name.endswith(".safetensors") for name in names)
    assert not names & {"richmap/fraction_map.py", "richmap/rm4d.py", "richmap/construction.py", "benchmark/speed.py"}
    assert len(code_version()) == 12


def test_a_fresh_set_up_gets_the_versions_that_stored_rows_carry():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pinned = {each.name: each.specifier for each in map(Requirement, project["dependencies"])}
    for name in {*PACKAGES, *cache.PACKAGES}:
        (specifier,) = pinned[name]
        assert specifier.operator == "==" and specifier.version == importlib.metadata.version(name)
