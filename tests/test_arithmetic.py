"""How a process rounds: alike with the instruction sets of other processors, and a row says so."""

import os
import platform
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="The libraries are told how on x86-64 alone.")

WITHOUT_AVX512 = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW",
}
"""Has PyTorch and the C library work as on a processor of before AVX-512."""

EPISODE = """
from pathlib import Path
from rich.console import Console
from benchmark.arithmetic import arithmetic
from benchmark.config import RobotConfig, RunConfig
from benchmark.replay import alone
from benchmark.results import row_hash
from benchmark.make_rollout import make_rollout

policy = Path("results/checkpoints/seed42-1")
rollout = make_rollout(RunConfig(robot=RobotConfig("ur3"), method="projection"), 0.02, policy, Console(quiet=True))
row = alone(rollout, 50_004).row()
print(arithmetic(), row["arithmetic"], row_hash(row), row["length"])
"""


def said(program, **environment):
    """What a new process prints, with these variables set."""
    free = {name: value for name, value in os.environ.items() if name not in ("MKL_CBWR", "OPENBLAS_CORETYPE")}
    done = subprocess.run(
        [sys.executable, "-c", program], env=free | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()[-4:]


def test_an_episode_is_the_same_with_the_instruction_sets_of_an_older_processor():
    here, elsewhere = said(EPISODE), said(EPISODE, **WITHOUT_AVX512)
    assert here == elsewhere
    assert here[0] == here[1]
    assert int(here[3]) > 50


@pytest.mark.parametrize("otherwise", [{"MKL_CBWR": "AVX2"}, {"OPENBLAS_CORETYPE": "Nehalem"}])
def test_what_rounds_otherwise_says_so(otherwise):
    probe = "from benchmark.arithmetic import arithmetic; print(arithmetic())"
    assert said(probe, **otherwise) != said(probe)
