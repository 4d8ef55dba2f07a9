"""Every configuration composes, and its values are those of the schema but for what it says."""

import dataclasses
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from benchmark import command
from benchmark.ablation import AblationConfig
from benchmark.approximate_ik import ApproximateIkConfig
from benchmark.arms import ArmsConfig
from benchmark.build_maps import BuildMapsConfig
from benchmark.capability_map import CapabilityMapConfig
from benchmark.cause_videos import CauseVideosConfig
from benchmark.config import OracleConfig, RunConfig, VerifyMapsConfig
from benchmark.dashboard import DashboardConfig
from benchmark.demonstration_recipe import CollectConfig
from benchmark.enter import EnterConfig
from benchmark.environment_speed import EnvironmentSpeedConfig
from benchmark.failure_places import FailurePlacesConfig
from benchmark.field_sensitivity import FieldSensitivityConfig
from benchmark.lambda_curves import LambdaCurvesConfig
from benchmark.leaderboard import LeaderboardConfig
from benchmark.lerobot_agreement import LerobotAgreementConfig
from benchmark.map_growth import MapGrowthConfig
from benchmark.merge_maps import MergeMapsConfig
from benchmark.pictures import PicturesConfig
from benchmark.place_bases import PlaceBasesConfig
from benchmark.prediction import PredictionConfig
from benchmark.replay import ReplayConfig
from benchmark.response import ResponseConfig
from benchmark.scales import ScalesConfig
from benchmark.scene_reach import SceneReachConfig
from benchmark.self_collision import SelfCollisionConfig
from benchmark.source_policies import SourcePoliciesConfig
from benchmark.speed import SpeedConfig
from benchmark.top_view import TopViewConfig
from benchmark.train import TrainConfig
from benchmark.view import ViewConfig

SCHEMAS = {
    "run": RunConfig,
    "record": RunConfig,
    "frames": RunConfig,
    "top_view": TopViewConfig,
    "lambda_curves": LambdaCurvesConfig,
    "prediction": PredictionConfig,
    "failure_places": FailurePlacesConfig,
    "scene_reach": SceneReachConfig,
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
    "response": ResponseConfig,
    "collect": CollectConfig,
    "train": TrainConfig,
    "ablation": AblationConfig,
    "source_policies": SourcePoliciesConfig,
    "self_collision": SelfCollisionConfig,
    "speed": SpeedConfig,
    "verify_maps": VerifyMapsConfig,
    "map_growth": MapGrowthConfig,
    "capability_map": CapabilityMapConfig,
    "approximate_ik": ApproximateIkConfig,
    "field_sensitivity": FieldSensitivityConfig,
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
