"""Whether bfloat16, where settings ask for it, is what the hardware computes in."""

import torch

INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16")
"""Of x86 and ARM processors, as torch names them."""


def in_bfloat16(precision: str, device: torch.device) -> bool:
    """Whether a stage whose settings say `precision` runs in bfloat16 on `device`. Where the hardware has no such arithmetic it
    runs in float32: without the instructions, a matrix product in bfloat16 takes ninety times as long (measured on an AMD EPYC with AVX2)."""
    return precision == "bfloat16" and has_bfloat16(device)


def has_bfloat16(device: torch.device) -> bool:
    """Whether `device` multiplies bfloat16 matrices without emulation."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        found = torch.cpu.get_capabilities()
        return any(found.get(name) for name in INSTRUCTIONS)
    return True
