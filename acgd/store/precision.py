"""The precision of a stage: bfloat16 where the settings name it and the hardware has it, else float32."""

import torch

INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16")
"""Instruction sets of x86 and ARM processors with bfloat16 products, as torch names them."""


def in_bfloat16(precision: str, device: torch.device) -> bool:
    """Whether a stage with the setting `precision` computes in bfloat16 on `device`.

    A stage computes in float32 on hardware without bfloat16. There a matrix product in bfloat16 takes ninety times as
    long (measured on an AMD EPYC with AVX2).
    """
    return precision == "bfloat16" and has_bfloat16(device)


def has_bfloat16(device: torch.device) -> bool:
    """Whether `device` multiplies bfloat16 matrices without emulation."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        capabilities = torch.cpu.get_capabilities()
        return any(capabilities.get(name) for name in INSTRUCTIONS)
    return True
