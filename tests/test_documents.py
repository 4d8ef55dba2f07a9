"""What the documents link to is there, and what is there stands in the documents."""

import re
from pathlib import Path

import gymnasium
import pytest

pytestmark = pytest.mark.results

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "results").rglob("*.md"))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files(document):
    links = re.findall(r"\]\(([^)#\s]+)", document.read_text())
    missing = [link for link in links if "://" not in link and not (document.parent / link).exists()]
    assert not missing


def test_the_readme_is_read_in_one_go():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


@pytest.mark.parametrize(
    "name, page", [("BlockPush-xArm6-v0", "gymnasium.md"), ("PressButtons-xArm6-v0", "press_buttons.md")]
)
def test_every_key_of_an_info_is_in_its_table(name, page):
    import envs  # noqa: F401, registers the environments

    env = gymnasium.make(name, disable_env_checker=True)
    _, info = env.reset(seed=0)
    env.close()
    table = (ROOT / "docs" / page).read_text().partition("## Info")[2].partition("\n## ")[0]
    assert {*info} <= {*re.findall(r"`(\w+)`", table)}
