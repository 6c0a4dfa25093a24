"""Where to compute, and in which precision."""

from __future__ import annotations

import torch

from evalkit.errors import InputError
from posenet.config import PRECISIONS


def choose_device(name: str, count: int = 1) -> torch.device:
    """`auto` is CUDA when there is a GPU, else the CPU; `count` of them are wanted.

    Raises:
        InputError: the device is unknown or absent, or there are not so many.
    """
    device = _device(name)
    if device.type == "cuda" and count > torch.cuda.device_count():
        raise InputError(f"--devices {count}: PyTorch sees {torch.cuda.device_count()} GPU(s) here; give no more.")
    return device


def _device(name: str) -> torch.device:
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"--device '{name}' is not known; use auto, cpu or cuda.") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch sees no GPU here; use --device cpu, or install a CUDA build of torch.")
    if device.type not in ("cpu", "cuda"):
        raise InputError(f"--device '{name}' is not supported; use auto, cpu or cuda.")
    return device


def layers_in_bf16(precision: str, device: torch.device) -> bool:
    """Whether a network's layers are to run in bf16: `precision` is one of PRECISIONS.

    Raises:
        InputError: it is none of them.
    """
    if precision not in PRECISIONS:
        raise InputError(f"--precision '{precision}' is not known; use one of {', '.join(PRECISIONS)}.")
    return precision == "bfloat16" or (precision == "auto" and supports_bf16(device))


def supports_bf16(device: torch.device) -> bool:
    """Whether the hardware multiplies bf16 itself; emulated, it is slower than float32."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
