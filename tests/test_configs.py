"""Every configuration composes, and its values are those of the schema but for what it says."""

import dataclasses
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from benchmark.build_maps import BuildMapsConfig
from benchmark.dashboard import DashboardConfig
from benchmark.enter import EnterConfig
from benchmark.leaderboard import LeaderboardConfig
from benchmark.map_quality.approximate_ik import ApproximateIkConfig
from benchmark.map_quality.capability_map import CapabilityMapConfig
from benchmark.map_quality.map_growth import MapGrowthConfig
from benchmark.map_quality.pictures import PicturesConfig
from benchmark.map_quality.self_collision import SelfCollisionConfig
from benchmark.map_quality.speed import SpeedConfig
from benchmark.map_quality.view import ViewConfig
from benchmark.merge_maps import MergeMapsConfig
from benchmark.settings import command
from benchmark.settings.config import OracleConfig, RunConfig, VerifyMapsConfig
from benchmark.settings.replay_config import ReplayConfig
from benchmark.source_policies import SourcePoliciesConfig
from benchmark.studies.arms import ArmsConfig
from benchmark.studies.cause_videos import CauseVideosConfig
from benchmark.studies.environment_speed import EnvironmentSpeedConfig
from benchmark.studies.lerobot_agreement import LerobotAgreementConfig
from benchmark.studies.place_bases import PlaceBasesConfig
from benchmark.studies.top_view import TopViewConfig
from benchmark.sweeps.scale_sweep import ScalesConfig
from benchmark.training.demonstration_recipe import CollectConfig
from benchmark.training.trainer import TrainConfig

SCHEMAS = {
    "run": RunConfig,
    "record": RunConfig,
    "top_view": TopViewConfig,
    "cause_videos": CauseVideosConfig,
    "build_maps": BuildMapsConfig,
    "merge_maps": MergeMapsConfig,
    "oracle": OracleConfig,
    "arms": ArmsConfig,
    "place_bases": PlaceBasesConfig,
    "scales": ScalesConfig,
    "leaderboard": LeaderboardConfig,
    "dashboard": DashboardConfig,
    "enter": EnterConfig,
    "replay": ReplayConfig,
    "lerobot_agreement": LerobotAgreementConfig,
    "environment_speed": EnvironmentSpeedConfig,
    "collect": CollectConfig,
    "train": TrainConfig,
    "source_policies": SourcePoliciesConfig,
    "self_collision": SelfCollisionConfig,
    "speed": SpeedConfig,
    "verify_maps": VerifyMapsConfig,
    "map_growth": MapGrowthConfig,
    "capability_map": CapabilityMapConfig,
    "approximate_ik": ApproximateIkConfig,
    "pictures": PicturesConfig,
    "view": ViewConfig,
}


def test_every_configuration_has_a_schema():
    assert {file.stem for file in Path(command.CONF).glob("*.yaml")} - {"quiet"} == set(SCHEMAS)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_configuration_composes_to_its_schema(name):
    schema = SCHEMAS[name]
    ConfigStore.instance().store(f"{name}_schema", command.named_as_typed(OmegaConf.structured(schema)))
    with initialize_config_dir(str(command.CONF), version_base="1.3"):
        config = compose(name)
    typed = command.typed(config, schema)
    assert isinstance(typed, schema)
    if not hasattr(schema, "robot") and "robot" not in {f.name for f in dataclasses.fields(schema)}:
        assert typed == schema()


@pytest.mark.parametrize("schema", SCHEMAS.values())
def test_every_setting_is_described(schema):
    for name, (text, _) in command.setting_texts(schema).items():
        assert text, name
