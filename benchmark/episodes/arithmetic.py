"""How this process rounds: a row replays to the last bit where sums and products are rounded as where it was stored.

`benchmark/__init__.py` asks the libraries of linear algebra for one way of rounding on all x86-64 processors with AVX2.
"""

import hashlib
from functools import cache


@cache
def arithmetic() -> str:
    """SHA-256, first 8 digits, over what an episode is made of: features and layers of a policy, and small systems of
    equations."""
    import numpy as np
    import torch

    from policies.block_push.features import observation_features

    random = np.random.default_rng(0)
    batches = [random.standard_normal((rows, 336)).astype(np.float32) for rows in (1, 3, 50)]
    weights = torch.from_numpy(random.standard_normal((128, 336)).astype(np.float32))
    systems = random.standard_normal((50, 6, 6))
    digest = hashlib.sha256()
    with torch.inference_mode():
        scene = torch.from_numpy(random.uniform(-0.5, 0.5, (50, 16)).astype(np.float32))[:, None]
        digest.update(observation_features(scene[..., :4], scene[..., 4:]).numpy().tobytes())
        for batch in map(torch.from_numpy, batches):
            layer = torch.nn.functional.layer_norm(batch @ weights.T, (128,))
            digest.update(torch.nn.functional.mish(layer).numpy().tobytes())
    for values in (systems @ systems, np.linalg.solve(systems, systems[::-1])):
        digest.update(values.tobytes())
    return digest.hexdigest()[:8]
