"""The trunks: shapes, alignment of the feature grid, and loading ImageNet's weights."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from evalkit.errors import InputError
from posenet.network import backbone as trunks

NAMES = ["vgg16", "vgg_small", "vgg_debug"]


@pytest.mark.parametrize("name", NAMES)
def test_features_cover_the_image_at_the_stated_stride(name: str) -> None:
    trunk = trunks.build_backbone(name, 3).eval()
    with torch.no_grad():
        features = trunk(torch.zeros(2, 3, 64, 96))
    assert features.shape == (2, trunk.channels, 64 // trunk.stride, 96 // trunk.stride)


def test_vgg16_has_torchvisions_names_and_shapes() -> None:
    shapes = {name: tuple(tensor.shape) for name, tensor in trunks.vgg16(3).state_dict().items()}
    convolutions = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]  # torchvision.models.vgg16
    assert set(shapes) == {f"features.{n}.{kind}" for n in convolutions for kind in ("weight", "bias")}
    assert shapes["features.0.weight"] == (64, 3, 3, 3)
    assert shapes["features.28.weight"] == (512, 512, 3, 3)
    assert sum(p.numel() for p in trunks.vgg16(3).parameters()) == 14_714_688  # the published figure


def test_signals_keep_their_size_through_an_untrained_vgg16() -> None:
    torch.manual_seed(0)
    features = trunks.vgg16(3)(torch.randn(1, 3, 64, 64))
    assert 0.05 < features.std() < 20


@pytest.mark.parametrize("name", ["vgg_small", "vgg_debug"])
def test_a_cell_of_the_thin_trunks_sees_more_than_the_largest_object(name: str) -> None:
    trunk = trunks.build_backbone(name, 1).eval()
    for module in trunk.modules():
        if isinstance(module, torch.nn.Conv2d):
            torch.nn.init.ones_(module.weight)  # so that nothing is hidden by a dead unit
    image = torch.rand(1, 1, 240, 320, requires_grad=True)
    trunk(image)[0, :, 15, 20].sum().backward()
    assert image.grad is not None
    seen = image.grad[0, 0].nonzero()
    low, high = seen.min(0).values, seen.max(0).values
    assert ((high - low) > 90).all()
    center = (low + high + 1) / 2
    cell = torch.tensor([15.5, 20.5]) * trunk.stride
    assert ((center - cell).abs() <= trunk.stride / 2).all()


def test_the_thin_trunk_sees_a_mirrored_image_mirrored() -> None:
    """The grid is centered on the image: with mirrored kernels a mirrored image gives the mirrored features."""
    torch.manual_seed(0)
    trunk = trunks.thin_vgg(1, widths=(8, 8, 8)).eval()
    image = torch.rand(1, 1, 64, 96)
    features = trunk(image)
    for module in trunk.modules():
        if isinstance(module, torch.nn.Conv2d):
            module.weight.data = module.weight.data.flip(-1)
    torch.testing.assert_close(trunk(image.flip(-1)).flip(-1), features, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("norm", ["batch", "group"])
def test_thin_trunks_run_in_bfloat16_and_channels_last(norm: str) -> None:
    trunk = trunks.thin_vgg(3, widths=(8, 16, 32), norm=norm).to(memory_format=torch.channels_last)
    images = torch.randn(2, 3, 64, 64).contiguous(memory_format=torch.channels_last)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        features = trunk(images)
    features.float().mean().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in trunk.parameters())


def test_the_same_seed_gives_the_same_trunk() -> None:
    torch.manual_seed(3)
    first = trunks.build_backbone("vgg_debug", 3).state_dict()
    torch.manual_seed(3)
    second = trunks.build_backbone("vgg_debug", 3).state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_an_unknown_trunk_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="resnet"):
        trunks.build_backbone("resnet", 3)


def test_a_torchvision_file_loads_without_its_classifier(tmp_path: Path) -> None:
    source = trunks.vgg16(3)
    file = tmp_path / "vgg16.pth"
    torch.save({**source.state_dict(), "classifier.0.weight": torch.zeros(2, 2)}, file)
    target = trunks.vgg16(3)
    trunks.load_vgg16_weights(target, file)
    assert all(torch.equal(a, b) for a, b in zip(source.parameters(), target.parameters(), strict=True))


@pytest.mark.parametrize("kind", ["absent", "folder", "text", "empty", "list", "other network", "pickle"])
def test_a_file_that_is_not_vgg16_weights_is_refused_in_one_sentence(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "weights.pth"
    if kind == "folder":
        file.mkdir()
    elif kind in ("text", "empty"):
        file.write_text("not weights" * (kind == "text"))
    elif kind == "list":
        torch.save([1, 2], file)
    elif kind == "other network":
        torch.save({"features.0.weight": torch.zeros(2)}, file)
    elif kind == "pickle":
        torch.save({"features.0.weight": Path("x")}, file)  # would need code of another module to load
    with pytest.raises(InputError, match=r"weights\.pth") as caught:
        trunks.load_vgg16_weights(trunks.thin_vgg(3), file)
    assert "\n" not in str(caught.value)


def test_weights_for_three_channels_are_refused_by_a_trunk_of_two(tmp_path: Path) -> None:
    file = tmp_path / "vgg16.pth"
    torch.save({"features.0.weight": torch.zeros(64, 3, 3, 3)}, file)
    with pytest.raises(InputError, match=r"features\.0\.weight.*three-channel"):
        trunks.load_vgg16_weights(trunks.vgg16(2), file)
