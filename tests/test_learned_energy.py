"""The energy in SE(3) made smaller: what plain ways leave out, and what a network learns."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmark.studies.energy_network import answered, trained
from benchmark.studies.learned_energy import compressed, drawn, errors
from richmap.geometry.grid import Grid
from richmap.similarity.directional import DirectionalEnergy


@pytest.fixture(scope="module")
def energy():
    """A field of degree 8 whose higher harmonics fade, as a kernel's do."""
    rng, degree = np.random.default_rng(0), 8
    of = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    values = rng.normal(size=(8, 8, 8, len(of))).astype(np.float32) * np.float32(0.5) ** of.astype(np.float32)
    values[0, 0, 0] = 0
    return DirectionalEnergy(Grid((-0.3, -0.3, 0.0), 0.1, (8, 8, 8)), values, {})


def test_more_harmonics_leave_out_less_and_the_field_itself_nothing(energy):
    asked = drawn(energy, 500, np.random.default_rng(1))
    truth = energy.value_and_gradients(*asked)
    sizes, off = {}, {}
    for form, size, ask in compressed(energy):
        sizes[form], off[form] = size, list(errors(ask(*asked), truth).values())
    assert off["as it is"] == [0, 0, 0] and sizes["as it is"] == energy.values.nbytes
    by_degree = np.array([off[f"degree {degree}"] for degree in (2, 4, 6)])
    assert (np.diff(by_degree, axis=0) < 0).all()
    assert sizes["degree 4"] == 2 * sizes["degree 4, in 16 bits"] == energy.values.nbytes * 25 // 81


def test_poses_are_drawn_where_the_field_says_something(energy):
    one = replace(energy, values=energy.values * (np.indices((8, 8, 8)) == 3).all(0)[..., None])
    positions, directions = drawn(one, 200, np.random.default_rng(2))
    assert (np.abs(positions - [0.05, 0.05, 0.35]) <= 0.05 + 1e-9).all()
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)


@pytest.mark.system
def test_a_network_learns_a_smooth_field_and_its_slopes_are_those_of_its_values():
    rng = np.random.default_rng(3)
    poses, (p, v) = ((rng.uniform(-1, 1, (n, 3)), unit(rng.normal(size=(n, 3)))) for n in (20_000, 300))
    said = lambda p, v: np.sin(2 * p[:, 0]) * v[:, 2] + p[:, 1] * v[:, 0]  # noqa: E731
    networks = [trained(poses, said(*poses), 32, 300, seed=0) for _ in range(2)]
    assert all(map(torch.equal, networks[0].parameters(), networks[1].parameters()))
    found, h = answered(networks[0], p, v), 1e-2
    assert np.sqrt(((found.value - said(p, v)) ** 2).mean()) < 0.2 * said(p, v).std()
    assert np.abs((found.direction * v).sum(1)).max() < 1e-5
    for axis, step in enumerate(h * np.eye(3)):
        rise = answered(networks[0], p + step, v).value - answered(networks[0], p - step, v).value
        np.testing.assert_allclose(found.position[:, axis], rise / (2 * h), atol=2e-2)
        along = step - (v @ step)[:, None] * v
        rise = answered(networks[0], p, unit(v + along)).value - answered(networks[0], p, unit(v - along)).value
        np.testing.assert_allclose((found.direction * along).sum(1), rise / 2, atol=2e-4)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
