"""What the README shows runs as it stands there."""

import re
from pathlib import Path

import gymnasium

README = Path(__file__).parents[1] / "README.md"


def test_the_vector_environment_with_a_foreign_policy():
    (code,) = [code for code in re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL) if "make_vec" in code]
    assert len(code.splitlines()) <= 10
    shown: dict = {}
    exec(code, shown)
    assert shown["over"].all()
    expected = []
    for seed in (50_000, 50_001, 50_002):  # One by one it comes to the same.
        env, over = gymnasium.make("BlockPush-UR3-v0"), False
        state, info = env.reset(seed=seed)
        while not over:
            state, _, terminated, truncated, info = env.step(shown["policy"](state[None])[0])
            over = terminated or truncated
        expected.append(info["p1"])
    assert shown["p1"].tolist() == expected and any(expected)
