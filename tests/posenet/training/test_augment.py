import pytest
import torch

from posenet.training.augment import Degradation, degrade, generator_of

DIAMETER = 0.1


def _table(height: int = 96, width: int = 128) -> torch.Tensor:
    return torch.full((height, width), 0.6) + 0.001 * torch.arange(height)[:, None]


def _degraded(depth: torch.Tensor, noise: float, holes: float, seed: int = 0) -> torch.Tensor:
    return degrade(depth, Degradation(noise, holes), DIAMETER, generator_of(seed, 0, 0))


def test_a_seed_a_step_and_an_image_give_one_degradation_and_others_another():
    images = [degrade(_table(), Degradation(0.02, 0.05), DIAMETER, generator_of(*key)) for key in
              ((0, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]  # fmt: skip
    assert torch.equal(images[0], images[1])
    assert all(not torch.equal(images[0], other) for other in images[2:])


def test_without_bounds_smooth_surface_stays_as_it_is():
    assert torch.equal(_degraded(_table(), 0.0, 0.0), _table())


def test_noise_stays_within_its_bound_and_differs_from_image_to_image():
    errors = torch.tensor([(_degraded(_table(), 0.02, 0.0, seed) - _table()).std() for seed in range(30)])
    assert errors.max() <= 0.02 * DIAMETER * 1.5 + 1e-6
    assert errors.std() > 0.2 * errors.mean()


def test_noise_of_neighbouring_pixels_is_correlated():
    error = _degraded(_table(), 0.02, 0.0) - _table()
    near = (error[:, 1:] * error[:, :-1]).mean() / error.square().mean()
    assert near > 0.2


def test_holes_stay_holes_and_new_ones_cover_no_more_than_their_share():
    table = _table()
    table[10:20, 10:20] = 0.0
    shares = []
    for seed in range(20):
        holes = _degraded(table, 0.01, 0.2, seed) == 0
        assert holes[10:20, 10:20].all()
        shares.append(float(holes.float().mean()))
    assert 0.02 < sum(shares) / len(shares) < 0.2


def test_edges_lose_returns_beside_them_and_nothing_is_lost_far_away():
    step = torch.full((96, 128), 0.6)
    step[:, 64:] = 0.5
    lost = torch.stack([_degraded(step, 0.0, 0.0, seed) == 0 for seed in range(20)]).float().mean(0)
    assert lost[:, 60:69].mean() > 0.1
    assert lost[:, :56].sum() == lost[:, 72:].sum() == 0


@pytest.mark.parametrize("image", [torch.zeros(96, 128), torch.full((96, 128), 0.5)])
def test_an_image_of_holes_and_a_flat_one_stay_finite(image: torch.Tensor):
    degraded = _degraded(image, 0.05, 0.3)
    assert torch.isfinite(degraded).all() and (degraded >= 0).all()
