"""The policy of `configuration_two_layer`; LeRobot finds it by this module's name."""

import torch
from lerobot.policies.pretrained import PreTrainedPolicy

from tests.configuration_two_layer import TwoLayerConfig


class TwoLayerPolicy(PreTrainedPolicy):
    """Two linear layers without biases, and a rectifier between them."""

    config_class = TwoLayerConfig
    name = "two_layer"

    def __init__(self, config, **kwargs):
        super().__init__(config)
        seen = sum(feature.shape[0] for feature in config.input_features.values())
        self.first = torch.nn.Linear(seen, config.hidden, bias=False)
        self.second = torch.nn.Linear(config.hidden, config.action_feature.shape[0], bias=False)

    def select_action(self, batch, **kwargs):
        seen = torch.cat([batch[name] for name in self.config.input_features], dim=-1)
        return self.second(torch.relu(self.first(seen)))

    def predict_action_chunk(self, batch, **kwargs):
        return self.select_action(batch)[:, None]

    def forward(self, batch):
        raise NotImplementedError

    def get_optim_params(self):
        return self.parameters()

    def reset(self):
        pass
