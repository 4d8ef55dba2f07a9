"""Which code decides an episode, and which commit it is of."""

import hashlib
import subprocess
from functools import cache
from modulefinder import ModuleFinder
from pathlib import Path

from benchmark.artifacts.cache import package_versions

ROOT = Path(__file__).parents[2]

PACKAGES = ("mujoco", "robosuite", "pin", "coal", "numpy", "scipy", "numba", "torch", "lerobot", "diffusers")
"""Whose versions decide an episode; pinned exactly."""

OWN = ("rollout", "stock_policy", "guidance_class", "arm_oracle")
"""Modules here that decide an episode."""

ALIKE = {"75f4cf8a43e5": "ce7997918d00"}
"""The version by an older one whose episodes it gives, so that they go by its name: after each change that was meant to
change no episode, all rows drawn at random replayed to the last bit (`python -m benchmark.replay
table=results/transfer/robust random=60 seed=10`, and `table=results/methods/robust/ur3-embodied/reorder random=40
seed=11`; descriptions of the arms that come as MJCF rounded: `table=results/scales/robust/ur3-best random=40 seed=12`;
then more files and packages came under the version; closer bounds of the arms' convex parts:
`table=results/transfer/robust random=60 seed=20`, and where links touch `tests/test_collision_bounds.py`; an entry's
class may import what lies beside it, by its source alone: `table=results/entries/hand-over
entry=benchmark/entries/hand_over
random=30 seed=31`; what an entry may not be is refused: the same with `seed=32`, and `table=results/methods random=20
seed=33`). Before that, single-precision functions of the policies were moved to double, which changes last
bits, as another processor did, and so `arithmetic`: of the UR3's 4,950 episodes of `experiment=transfer` 4.1 % then had
another p2 on one machine, and 4.6 % had by the code of before on two machines."""


@cache
def code_version() -> str:
    """SHA-256, first 12 digits, over the code, collision geometry and packages that decide an episode.

    That is a rollout's own code, how an entry's guidance is asked, the environments, the policies, and of `richmap`
    what these import: not how maps are built, which the fingerprint of a row's field stands for, nor how they are asked
    and verified. See `ALIKE`.
    """
    digest = hashlib.sha256(package_versions(*PACKAGES).encode())
    for file in deciding_files():
        digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    version = digest.hexdigest()[:12]
    return ALIKE.get(version, version)


def deciding_files() -> list[Path]:
    """The files that `code_version` is over."""
    own = [ROOT / "benchmark" / "rollouts" / f"{name}.py" for name in OWN]
    own += [file for package in ("envs", "policies") for file in (ROOT / package).rglob("*.py")]
    noted = ["richmap.similarity.similarity", "benchmark.settings.config"]  # Columns stand for field and settings.
    finder = ModuleFinder(path=[str(ROOT)], excludes=noted)
    for file in own:
        finder.run_script(str(file))
    files = (getattr(module, "__file__", None) for module in finder.modules.values())
    found = {Path(file) for file in files if file}
    imported = {file for file in found if file.is_relative_to(ROOT / "richmap")}
    return sorted({*own, *imported, *(ROOT / "richmap").rglob("*.safetensors")})


@cache
def commit() -> str:
    """Git commit of this tree, when this process first asked, with + if tracked files other than results differ from
    it; empty outside a checkout."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)results")
        return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return ""
