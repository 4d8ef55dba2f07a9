import numpy as np
import pytest
from rich.console import Console

from benchmark.artifacts import maps
from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.arm import suite_arms
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.suite import suite_conditions
from envs.block_push.workspace import HEIGHT
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField

pytestmark = pytest.mark.system


@pytest.fixture
def nothing_is_made(monkeypatch):
    """An error where a map or a table of what an arm can hold would be made."""

    def make(*_, **__):
        raise AssertionError("made anew")

    monkeypatch.setattr(maps, "robot_map", make)
    monkeypatch.setattr("envs.arm.feasibility.table_feasibility", make)
    guidance_field.cache_clear()
    yield
    guidance_field.cache_clear()


def of(kind, arm, **of_map):
    return guidance_field(kind, arm, MapConfig(**of_map), EnergyConfig(), 1, Console(quiet=True))


def arms_of(suite):
    """Of its conditions of block push."""
    conditions = {name: each for name, each in suite_conditions(suite).items() if each.task == "block_push"}
    return suite_arms(conditions).values()


@pytest.mark.parametrize("suite", ["push-v1", "official", "quick", "full"])
def test_what_the_arms_of_the_suites_can_hold_ships(nothing_is_made, suite):
    for arm in arms_of(suite):
        field, file = of("feasibility", arm)
        assert isinstance(field, SignedDistanceField) and file.parent == maps.SHIPPED


@pytest.mark.parametrize("kind", ["reach", "branch_reach"])
def test_what_the_arms_of_the_ranking_can_hold_by_their_maps_ships(nothing_is_made, kind):
    for arm in arms_of("full"):
        field, file = of(kind, arm)
        assert isinstance(field, SignedDistanceField) and file.parent == maps.SHIPPED


@pytest.mark.parametrize("suite", ["official", "quick", "full"])
def test_a_first_run_needs_no_map(nothing_is_made, suite):
    for arm in arms_of(suite):
        field, file = of("energy", arm)
        assert isinstance(field, EnergyField) and file.parent == maps.SHIPPED


def test_other_settings_are_built_and_so_is_what_is_asked_to_be(nothing_is_made, monkeypatch, tmp_path):
    arm = suite_arms(suite_conditions("official"))["ur3"]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for of_map in ({"cell_size": 0.1}, {"seed": 1}, {"rebuild": True}):
        with pytest.raises(AssertionError, match="made anew"):
            of("energy", arm, **of_map)


def test_a_field_that_ships_is_the_one_that_is_made():
    arm = suite_arms(suite_conditions("quick"))["ur3-near-10cm"]
    (shipped, _), (made, file) = of("feasibility", arm), of("feasibility", arm, rebuild=True)
    assert file.parent != maps.SHIPPED
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.1, -0.6, 0.06), (0.8, 0.6, 0.06), (1000, 3))
    assert np.array_equal(shipped.value_and_gradient(points)[0], made.value_and_gradient(points)[0])


def test_what_arms_can_hold_by_the_map_of_their_branch_is_nearly_what_they_can_by_their_kinematics(nothing_is_made):
    """Of what either has, at least 0.93 is common; by the map of all branches it is less on every UR."""
    x, y = np.meshgrid(np.arange(0.15, 0.7, 0.01), np.arange(-0.5, 0.5, 0.01))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, HEIGHT)], 1)
    for arm in arms_of("full"):
        kinds = {kind: of(kind, arm)[0] for kind in ("feasibility", "branch_reach", "reach")}
        held, in_branch, in_any = (field.value_and_gradient(points)[0] < 0 for field in kinds.values())
        common = (held & in_branch).sum() / (held | in_branch).sum()
        assert common > 0.93
        assert not arm.robot.startswith("ur") or common > (held & in_any).sum() / (held | in_any).sum()
