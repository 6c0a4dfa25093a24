"""Muon's steps of matrices are orthogonal ones, those of all else are AdamW's, and it goes on from where it was."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn

from posenet.optimizers.muon import ADAM_SIZE, BETAS, EPSILON, LARGEST, Muon, is_matrix, orthogonal


def parameter(*shape: int, seed: int = 0) -> nn.Parameter:
    return nn.Parameter(torch.randn(shape, generator=torch.Generator().manual_seed(seed)))


def walk(parts: list[nn.Parameter], optimizer: torch.optim.Optimizer, steps: int, seed: int) -> None:
    """Steps along random gradients."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        for part in parts:
            part.grad = torch.randn(part.shape, generator=generator)
        optimizer.step()


@pytest.mark.parametrize("shape", [(8, 8), (6, 50), (50, 6), (1, 9)])
@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_all_singular_values_come_near_one(shape: tuple[int, int], precision: torch.dtype) -> None:
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(1)) * torch.logspace(-1, 1, shape[1])
    turned = orthogonal(matrix.to(precision)).float()
    values = torch.linalg.svdvals(turned)
    assert values.max() < 1.3
    assert values.mean() > 0.6 and values.min() > 0.3
    left, _, right = torch.linalg.svd(matrix, full_matrices=False)
    assert (turned * (left @ right)).sum() / min(shape) > 0.6  # it turns the way that the exact one does


def test_a_gradient_of_nothing_moves_nothing_but_decay() -> None:
    part = parameter(4, 6)
    before = part.detach().clone()
    part.grad = torch.zeros_like(part)
    Muon([part], lr=0.1, weight_decay=0.5).step()
    torch.testing.assert_close(part.detach(), before * (1 - 0.1 * 0.5))


def test_vectors_and_large_matrices_take_adamw_steps() -> None:
    shapes = [(7,), (2, LARGEST // 2 + 1)]
    ours, theirs = ([parameter(*shape) for shape in shapes] for _ in range(2))
    assert not any(map(is_matrix, ours))
    walk(ours, Muon(ours, lr=1e-2, weight_decay=0.1), 3, seed=2)
    walk(theirs, torch.optim.AdamW(theirs, lr=1e-2, betas=BETAS, eps=EPSILON, weight_decay=0.1), 3, seed=2)
    for own, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(own, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shape", [(16, 16), (8, 100), (100, 8), (6, 4, 3, 3)])
def test_a_step_is_as_large_as_one_of_adamw(shape: tuple[int, ...]) -> None:
    part = parameter(*shape)
    assert is_matrix(part)
    before = part.detach().clone()
    walk([part], Muon([part], lr=1e-3), 1, seed=3)
    step = (part.detach() - before).square().mean().sqrt() / 1e-3
    assert ADAM_SIZE * 0.6 < step < ADAM_SIZE * 1.3


def test_restored_it_goes_on_bit_for_bit() -> None:
    parts, others = ([parameter(5, 8), parameter(5)] for _ in range(2))
    first, second = Muon(parts, lr=1e-2), Muon(others, lr=1e-2)
    walk(parts, first, 3, seed=4)
    with torch.no_grad():
        for part, other in zip(parts, others, strict=True):
            other.copy_(part)
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    walk(parts, first, 3, seed=5)
    walk(others, second, 3, seed=5)
    assert all(torch.equal(part, other) for part, other in zip(parts, others, strict=True))


def test_it_solves_a_least_squares_problem_of_uneven_scales() -> None:
    scales = torch.logspace(0, -1.5, 12)
    wanted = torch.randn(6, 12, generator=torch.Generator().manual_seed(6))
    part = parameter(6, 12)

    def loss() -> Tensor:
        return ((part - wanted) * scales).square().sum()

    optimizer, before = Muon([part], lr=0.05), loss().item()
    for step in range(300):
        optimizer.param_groups[0]["lr"] = 0.05 * (1 - step / 300)
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()
    assert loss().item() < 0.05 * before
