"""What the README shows runs as it stands there, and what the documents link to is there."""

import re
from pathlib import Path

import gymnasium
import pytest

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"


DOCUMENTS = [README, *sorted((ROOT / "results").rglob("*.md"))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files(document):
    links = re.findall(r"\]\(([^)#\s]+)", document.read_text())
    missing = [link for link in links if "://" not in link and not (document.parent / link).exists()]
    assert not missing


def test_the_vector_environment_with_a_foreign_policy():
    (code,) = [code for code in re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL) if "make_vec" in code]
    assert len(code.splitlines()) <= 10
    shown: dict = {}
    exec(code, shown)
    assert shown["over"].all()
    expected = []
    for seed in (50_000, 50_001, 50_002):  # One by one it comes to the same.
        env, over = gymnasium.make("BlockPush-UR3-v0"), False
        state, info = env.reset(seed=seed)
        while not over:
            state, _, terminated, truncated, info = env.step(shown["policy"](state[None])[0])
            over = terminated or truncated
        expected.append(info["p1"])
    assert shown["p1"].tolist() == expected and any(expected)
