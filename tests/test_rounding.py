"""How a process rounds: alike with the instruction sets of other processors."""

import os
import platform
import subprocess
import sys

import pytest
import torch
from rich.console import Console
from torch.utils._python_dispatch import TorchDispatchMode

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import load_policy
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(platform.machine() != "x86_64", reason="The libraries are told how on x86-64 alone."),
]

WITHOUT_AVX512 = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL",
}
"""Has PyTorch, NumPy and the C library work as on a processor of before AVX-512."""

EPISODE = """
from pathlib import Path
from rich.console import Console
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.config import RunConfig
from benchmark.rollouts.make_rollout import make_rollout

policy = Path("results/checkpoints/seed42-1")
rollout = make_rollout(RunConfig(robot=RobotConfig("ur3"), method="projection"), 0.02, policy, Console(quiet=True))
outcome = str(rollout.play([50_004])[0].outcome)
"""


def test_an_episode_is_the_same_with_the_instruction_sets_of_an_older_processor():
    free = {name: value for name, value in os.environ.items() if name not in ("MKL_CBWR", "OPENBLAS_CORETYPE")}
    command = [sys.executable, "-c", EPISODE + "print(outcome)"]
    elsewhere = subprocess.run(command, env=free | WITHOUT_AVX512, capture_output=True, text=True, check=True)
    here = {}
    exec(EPISODE, here)  # This process rounds as every one of ours.
    assert here["outcome"] == elsewhere.stdout.splitlines()[-1] and "length=" in here["outcome"]


class Asked(TorchDispatchMode):
    """Notes which functions of PyTorch are asked for which type of numbers."""

    def __init__(self):
        super().__init__()
        self.functions = set()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        if isinstance(result, torch.Tensor):
            self.functions.add((function.overloadpacket.__name__, result.dtype))
        return result


@pytest.mark.parametrize("sampler", ["DDIM", "DDPM"])
@pytest.mark.parametrize("method", ["towards", "chunk_feasibility"])
def test_no_policy_asks_mkl_for_a_function_of_single_precision(sampler, method):
    """MKL begins some of them from the processor's approximate reciprocals, of which each maker has its own."""
    config = RunConfig(robot=RobotConfig("ur3"), method=method, batch_size=2, device="cpu", sampler=sampler)
    rollout = make_rollout(config, 0.1, checkpoint_folder(42), Console(quiet=True))
    with Asked() as asked, torch.inference_mode():
        policy = load_policy(rollout)
        policy.reset()
        batch = {
            "observation.state": torch.full((2, 4), 0.3),
            "observation.environment_state": torch.full((2, 12), 0.2),
        }
        policy.select_action(batch, noise=torch.ones(2, *policy.noise_shape))
    assert ("tanh", torch.float64) in asked.functions and ("linear", torch.float32) in asked.functions
    rounded = {"acos", "asin", "atan", "cosh", "erf", "erfinv", "exp", "expm1", "log", "log10", "log1p", "log2", "pow",
               "rsqrt", "sinh", "sqrt", "tan", "tanh"}  # fmt: skip
    assert not asked.functions & {(name, torch.float32) for name in rounded}
