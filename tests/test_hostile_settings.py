"""Settings that would harm or cannot be, of every command: one line, within seconds, and no folder is left behind."""

import importlib
import os
import re
import sys
from pathlib import Path

import pytest

from benchmark.settings import command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.setting import SettingError
from richmap.outputs import replacing

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]
REFUSED = {
    "run": [
        "output_dir=", "output_dir=/proc", "output_dir=/sys/x", "output_dir=a\0b", "output_dir=/dev/null/x",
        "map.ground=nan", "map.ground=inf", "map.ground=5", "map.cell_size=1e-6", "map.cell_size=.001",
        "map.cell_size=nan", "map.cell_size=1e-300", "map.half_width=inf", "map.z_offset=nan",
        f"lambda=1{400 * '0'}", f"map.cell_size=1{400 * '0'}", f"episodes={5000 * '9'}", "map.stop_rate=1e-12",
        "map.draw=1000000000", "map.turns=1073741824",
        "map.target=1000000000000", "map.seed=-1", "workers=10000", "batch_size=1000000", "episodes=1000000000",
        "lambda=1e300", "lambda=inf", "method=best_of_n_energy lambda=1e6", "lambda=1e6", "sampling_steps=1000000",
        "hydra.run.dir=README.md/x", "hydra.run.dir=a/b lambda=-1", "-m lambda=0,1 hydra.sweep.dir=README.md/x",
        "wandb.mode=offline wandb.folder=", "wandb.mode=offline wandb.folder=/proc/x", "energy.smoothing=nan",
        "seed_start=4294967296", "episodes=2 seed_start=99999", "seed=-1", "arm.base=[1,2]", "arm.base=[nan,0,0]",
        "arm.base=[a,0,0]", "arm.base={x:1}", "seeds=[a]", "seeds=[1.5]", "seeds={a:1}", "seeds=[{a:1}]", "seeds=[[1]]",
        "workers={a:1}", "workers=[1]", "robot=custom robot.path={a:1}", "robot=custom robot.ignore=[[{a:1},b]]",
    ],
    "build_maps": [
        "output=/dev/null", "output=/", "output=.", "output=", "output=/proc/x", "output=~", "output=~/x",
        "workers=10000", "map.theta=.02 map.cell_size=.005",
    ],
    "similarity": ["base=[1,2]", "base=[nan,0,0]", "output=/dev/null", "a=custom"],
    "check": [
        "base.x=[1,0]", "base.x=[1,0] hydra.run.dir=a/b", "base.yaw=[nan,0]", "base.spacing=0.001", "speed=0", "fps=0",
        "scenes=0", "poses=nothing.csv", "output_dir=/proc",
    ],
    "merge_maps": ["output=/dev/null inputs=[a,b]", "inputs=[a,a]", "output=/dev/full inputs=[a,b]"],
    "compare_policies": [
        "alpha=0", "alpha=nan", "alpha=1", "episodes=0", "workers=10000", "seed_start=160000", "output_dir=/proc",
        "arm.base=[1,2]", "stop_early=perhaps", "robot=custom",
    ],
    "train": ["threads=100000", "batch_size=100000000", "keep=[1000,1000]"],
    "collect": [
        "seed_start=50000", "episodes=2 seed_start=49999", "episodes=1000000000", "workers=10000", "output_dir=",
    ],
    "learn_value": [
        "scenes=5", "scenes=50000", "scenes=20000 rounds=2", "rounds=-1", "each=0", "task=block_push",
        "output_dir=/proc", "seeds=[]", "seeds=[42,42]", "workers=10000", "arm.base=[1,2]",
    ],
    "enter": ["robots=[]", "robots=[ur3,ur3]", "seeds=[]", "batch_size=1000000", "seed_start=50000 scale=[1e300]"],
    "scales": [
        "scale=[0.1,1e300]", "scale=[.nan]", "scale=[{a:1}]", "methods=[]", "methods=[{a:1}]", "methods=[paper,paper]",
        "seeds=[42,42]", "points=1000",
    ],
    "choose_scales": ["methods=[]", "methods=[nothing]", "points=0", "suite=nothing"],
    "source_policies": ["seeds=[]", "seeds=[42,42]", "candidates=[]"],
    "studies.learned_energy": ["seed=-1", "widths=[]", "widths=[0]", "widths=[100000]", "poses=1000000000", "steps=0"],
    "map_quality.verify_maps": ["maps=[]", "maps=[richmap,richmap]"],
    "map_quality.view": ["save=/dev/null/x.html"],
}  # fmt: skip


def arguments():
    for module, lines in REFUSED.items():
        for line in lines:
            yield pytest.param(module, line, id=f"{module} {line!r}")


@pytest.mark.parametrize("module, line", [*arguments()])
def test_it_is_refused_in_one_line(module, line, tmp_path, monkeypatch, capsys):
    door = importlib.import_module(f"benchmark.{module}")
    schema, name = re.search(
        r"^    run_command\(main, (\w+), \"(\w+)\"", Path(door.__file__).read_text(), re.M
    ).groups()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "README.md").write_text("a file")
    monkeypatch.setattr(sys, "argv", ["command", *line.split(" ")])
    monkeypatch.setattr(command.signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit) as end:
        command.run_command(lambda config: pytest.fail(f"{line} was taken"), getattr(door, schema), name)
    errors = capsys.readouterr().err.splitlines()
    assert end.value.code == 2 and len(errors) == 1, errors
    assert line.split(" ")[-1].partition("=")[0] in errors[0] or "hydra" in line or line.split(" ")[0] in errors[0]
    assert not re.search(r"full_key|object_type|reference_type", errors[0]), "These are OmegaConf's words."
    assert os.listdir(tmp_path) == ["README.md"]


def test_what_costs_too_much_says_what_it_would_cost():
    with pytest.raises(SettingError, match=r"it takes about [\d,]+ GB of memory, and this machine has"):
        MapConfig(cell_size=0.001)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_regular_file_is_never_replaced(make, tmp_path):
    there = tmp_path / "there"
    make(there)
    with pytest.raises(SettingError, match="no regular file"):
        check_file(str(there))
    with pytest.raises(SettingError, match="no regular file"):
        check_file(f"{tmp_path}/nothing/../there")
    with pytest.raises(FileExistsError), replacing(there):
        pytest.fail("it was to be replaced")
    assert os.listdir(tmp_path) == ["there"] and not there.is_file()


def test_what_a_link_leads_to_is_replaced_and_not_the_link(tmp_path):
    (tmp_path / "file").write_text("old")
    (tmp_path / "link").symlink_to("file")
    with replacing(tmp_path / "link") as path:
        path.write_text("new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "file").read_text() == "new"
