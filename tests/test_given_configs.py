"""Files of settings that a stranger sends are data: none of them runs code, and each is refused in a line."""

import pytest

from benchmark.settings.given_configs import check_given
from benchmark.settings.setting import SettingError

GROUPS = ["experiment", "suite"]


def given(folder, text, name="mine"):
    (folder / "experiment").mkdir(exist_ok=True)
    (folder / "experiment" / f"{name}.yaml").write_text(text)
    return ["--config-dir", str(folder)]


@pytest.mark.parametrize(
    "text, message",
    [
        ("hydra: {callbacks: {evil: {_target_: pandas.read_pickle}}}", "sets hydra.callbacks, by which code is run"),
        ("hydra: {job_logging: {handlers: {}}}", "sets hydra.job_logging"),
        ("hydra: {sweeper: {_target_: os.system}}", "sets _target_"),
        ("map: {cell_size: {_target_: os.getcwd}}", "sets _target_"),
        ("lambda: [1, 2", "is no file of settings"),
        ("lambda: !!python/object/apply:os.system [ls]", "is no file of settings"),
        ("a: &a [1, 1]\nb: &b [*a, *a]", "has .names of other values"),
        ("a: &a [*a]", "has .names of other values"),
        ("", "holds no settings"),
        ("- 1", "holds no settings"),
        ("defaults: [mine]", "names itself in its defaults"),
        ("defaults: [_self_, other]", "other.yaml sets hydra.callbacks"),
        ("defaults: [{/experiment: other}]", "other.yaml sets hydra.callbacks"),
        ("defaults: [{override /experiment: other}]", "other.yaml sets hydra.callbacks"),
        ("defaults: [{deeper@_here_: [other]}]", "other.yaml sets hydra.callbacks"),
    ],
)
def test_a_file_that_names_code_or_is_damaged_is_refused(tmp_path, text, message):
    hostile = "hydra: {callbacks: {}, job: {name: x}}"
    given(tmp_path, hostile, "other")
    (tmp_path / "experiment" / "deeper").mkdir()
    (tmp_path / "experiment" / "deeper" / "other.yaml").write_text(hostile)
    flags = given(tmp_path, text)
    with pytest.raises(SettingError, match=message):
        check_given(flags, ["robot=ur3", "experiment=mine"], GROUPS, "run")
    with pytest.raises(SettingError, match="mine.yaml|other.yaml"):
        check_given(flags, ["experiment=glob(*)"], GROUPS, "run")
    check_given(flags, ["robot=ur3"], GROUPS, "run")  # It is not taken.


@pytest.mark.parametrize("override", ["experiment@_global_=mine", "+experiment=mine", "hydra.searchpath=[file:///tmp]"])
def test_no_other_way_leads_to_such_a_file(tmp_path, override):
    flags = given(tmp_path, "hydra: {callbacks: {}, job: {name: x}}\nx: {_target_: os.getcwd}")
    with pytest.raises(SettingError, match="code is run|hydra.searchpath is not allowed"):
        check_given(flags, [override], GROUPS, "run")


def test_a_primary_file_of_ones_own_is_looked_at_too(tmp_path):
    (tmp_path / "run.yaml").write_text("x: {_target_: os.getcwd}")
    for flags in (["--config-path", str(tmp_path)], ["-cd", str(tmp_path), "-cn", "run.yaml"]):
        with pytest.raises(SettingError, match="run.yaml sets _target_"):
            check_given(flags, [], GROUPS, "run")


def test_ordinary_files_pass(tmp_path):
    text = (
        "# @package _global_\ndefaults: [_self_]\nrobot: ur3\nhydra: {mode: MULTIRUN, sweeper: {params: {lambda: 0}}}"
    )
    check_given(given(tmp_path, text), ["experiment=mine,there-is-none"], GROUPS, "run")
