"""A class in a file, wherever a command takes a method."""

import re
from pathlib import Path

import pytest

from benchmark import run, scales
from benchmark.episodes.table import read_episodes
from benchmark.rollouts.entry import Entry
from benchmark.settings.config import LimitsConfig, RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.sweeps.scale_sweep import ScalesConfig

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]
FEW = {"episodes": 1, "batch_size": 1, "device": "cpu", "workers": 1}


def documented(folder):
    """The class of the documents, in a file."""
    text = (ROOT / "docs" / "add-method.md").read_text()
    (code,) = [code for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "class Slower" in code]
    (folder / "mine.py").write_text(code)
    return f"{folder / 'mine.py'}:Slower"


def configured(method, output, **values):
    return RunConfig(RobotConfig("xarm6"), method=method, output_dir=str(output), **FEW | values)


def test_a_class_is_run_at_a_scale_and_at_its_own_and_keeps_each_rows(brief, tmp_path, capsys):
    method, output = documented(tmp_path), tmp_path / "out"
    for scale in (0.9, None):
        run.main(configured(method, output, guidance_scale=scale))
    rows = read_episodes(output)
    assert rows[["method", "lambda"]].to_numpy().tolist() == [["direct", 0.0], ["slower", 0.5], ["slower", 0.9]]
    assert rows.entry_hash.map(bool).tolist() == [False, True, True]
    before = rows[rows["lambda"] == 0.9].entry_hash.item()
    file = tmp_path / "mine.py"
    file.write_text(file.read_text() + "# Better.\n")
    run.main(configured(method, output, guidance_scale=0.9))
    rows = read_episodes(output)
    assert rows["lambda"].tolist() == [0.0, 0.5, 0.9]
    assert rows.entry_hash[1] == before != rows.entry_hash[2]
    assert "other files of the method at this scale are dropped: 1." in " ".join(capsys.readouterr().out.split())


def test_its_scales_are_swept_beside_direct_transfer(brief, tmp_path, capsys):
    method = documented(tmp_path)
    few = FEW | {"episodes": 2, "seeds": [42], "robot": RobotConfig("xarm6"), "output_dir": str(tmp_path / "scales")}
    scales.main(ScalesConfig(methods=[method], scale=[0.8, 0.9], **few))
    folder = tmp_path / "scales" / "robust" / "xarm6-embodied"
    assert sorted({*read_episodes(folder / "slower")["lambda"]}) == [0.8, 0.9]
    assert "`slower`: λ is in the class's own unit" in (folder / "scales.md").read_text()
    assert "slower" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("Slower", "Paper"), "is called as its class is, paper. name=paper is not allowed"),
        (('"none"', '"magic"'), "field_kind=magic is not allowed. Allowed: energy, witness, coverage,"),
        (("default_scale = 0.5", "default_scale = float('nan')"), "default_scale=nan is not allowed"),
        (("class Slower(Guidance)", "class Slower"), "has no class Slower that is a policies.guidance.Guidance"),
        (("class", "import nothing_of_that_name\n\n\nclass"), "raised ModuleNotFoundError: No module named"),
    ],
)
def test_what_a_class_cannot_be_is_said_in_a_line(tmp_path, change, message):
    method = documented(tmp_path)
    file = tmp_path / "mine.py"
    file.write_text(file.read_text().replace(*change))
    method = method if "Paper" not in change else method.replace("Slower", "Paper")
    with pytest.raises(SettingError, match=message) as refused:
        Entry.of_class(method, LimitsConfig())
    assert "\n" not in str(refused.value)


def asking_for(folder, kind):
    """The class of the documents made with a field of a kind, of which it takes a signed distance alone."""
    method = documented(folder)
    text = (folder / "mine.py").read_text().replace('"none"', f'"{kind}"')
    taken = "        assert type(field).__name__ == 'SignedDistanceField'\n        self.scale = scale"
    (folder / "mine.py").write_text(text.replace("        self.scale = scale", taken))
    return method


def test_it_is_made_with_the_field_that_it_asks_for(brief, tmp_path):
    method = asking_for(tmp_path, "branch_reach")
    ur5 = RobotConfig("ur5")  # Of which that field ships.
    run.main(RunConfig(ur5, method=method, guidance_scale=0.9, output_dir=str(tmp_path / "out"), **FEW))
    rows = read_episodes(tmp_path / "out")
    assert rows[rows["lambda"] == 0.9].field_fingerprint.item()
    with pytest.raises(SettingError, match="Slower.* raised AssertionError"):
        method = asking_for(tmp_path, "energy")
        run.main(RunConfig(ur5, method=method, guidance_scale=0.9, output_dir=str(tmp_path / "out"), **FEW))


def test_a_field_of_another_task_s_poses_is_refused(tmp_path):
    method = asking_for(tmp_path, "feasibility")
    with pytest.raises(SettingError, match="block push's, unlike that of press_buttons. Ask for energy,"):
        run.main(configured(method, tmp_path / "out", task="press_buttons", guidance_scale=0.9))
    assert not (tmp_path / "out").exists()


def test_what_it_lacks_is_said_before_anything_is_run(tmp_path):
    with pytest.raises(SettingError, match="there is no file .*nowhere.py"):
        configured(f"{tmp_path}/nowhere.py:Slower", tmp_path)
    with pytest.raises(SettingError, match="or a class in a file, as in mine.py:Mine"):
        configured("Slower", tmp_path)
    method = documented(tmp_path)
    (tmp_path / "mine.py").write_text((tmp_path / "mine.py").read_text().replace("default_scale = 0.5", "x = 1"))
    with pytest.raises(SettingError, match="lambda=null: .*mine.py:Slower names no default_scale"):
        run.main(configured(method, tmp_path, guidance_scale=None))
    with pytest.raises(SettingError, match="names no default_scale. Give it one, or give scale="):
        scales.main(ScalesConfig(RobotConfig("xarm6"), methods=[method], seeds=[42], output_dir=str(tmp_path)))
