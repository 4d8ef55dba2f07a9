"""Which commit this tree is of."""

import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def commit() -> str:
    """Git commit of this tree, when this process first asked, with + if tracked files other than results differ from
    it; empty outside a checkout of its own."""
    if not (ROOT / ".git").exists():  # What is installed may lie within a checkout of something else.
        return ""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)results")
        return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return ""
