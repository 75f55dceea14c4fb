"""EfficientNet-Lite0 (Tan and Le 2019; the Lite variant has ReLU6 and no squeeze-and-excitation), for inference.

Each batch normalisation is folded into the convolution before it.
"""

from torch import Tensor, nn
from torch.nn import functional as F

FEATURES = 1280
EPSILON = 1e-3
"""Of the batch normalisations."""
STAGES = (
    # repeats, kernel, stride of the first block, expansion, outputs
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)


class Convolution(nn.Conv2d):
    """Padded as TensorFlow's `same`: of an odd number of zeros the larger half lies right and below."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride, groups=groups)

    def forward(self, x: Tensor) -> Tensor:
        kernel, stride = self.kernel_size[0], self.stride[0]
        height, width = (max((-(-n // stride) - 1) * stride + kernel - n, 0) for n in x.shape[-2:])
        if height or width:
            x = F.pad(x, (width // 2, width - width // 2, height // 2, height - height // 2))
        return super().forward(x)


class Block(nn.Module):
    """Inverted bottleneck: 1 x 1 to `expansion` times the width, k x k within each channel, 1 x 1 to `outputs`."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        width = expansion * inputs
        self.expand = Convolution(inputs, width, 1) if expansion > 1 else None
        self.depthwise = Convolution(width, width, kernel, stride, groups=width)
        self.project = Convolution(width, outputs, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        hidden = x if self.expand is None else F.relu6(self.expand(x))
        out = self.project(F.relu6(self.depthwise(hidden)))
        return x + out if self.residual else out


class EfficientNetLite0(nn.Module):
    """Normalised images (B, 3, H, W) -> pooled features (B, 1280), each in [0, 6]."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = Convolution(3, 32, 3, stride=2)
        blocks, inputs = [], 32
        for repeats, kernel, stride, expansion, outputs in STAGES:
            for i in range(repeats):
                blocks.append(Block(inputs, outputs, kernel, stride if i == 0 else 1, expansion))
                inputs = outputs
        self.blocks = nn.Sequential(*blocks)
        self.head = Convolution(inputs, FEATURES, 1)

    def forward(self, x: Tensor) -> Tensor:
        x = self.blocks(F.relu6(self.stem(x)))
        return F.relu6(self.head(x)).mean((2, 3))


def folded(published: dict[str, Tensor]) -> dict[str, Tensor]:
    """The state dict of EfficientNetLite0 from that of the published network. The classifier is left out."""
    state = {}
    for ours, convolution, normalisation in _names(published):
        mean, variance, scale, offset = (
            published[f"{normalisation}.{part}"].double() for part in ("running_mean", "running_var", "weight", "bias")
        )
        gain = scale / (variance + EPSILON).sqrt()
        weight = published[f"{convolution}.weight"].double() * gain[:, None, None, None]
        state[f"{ours}.weight"], state[f"{ours}.bias"] = weight.float(), (offset - mean * gain).float()
    return state


def _names(published: dict[str, Tensor]) -> list[tuple[str, str, str]]:
    """Our convolution, and the published convolution and batch normalisation that it is made of."""
    names = [("stem", "_conv_stem", "_bn0"), ("head", "_conv_head", "_bn1")]
    for i in range(sum(repeats for repeats, *_ in STAGES)):
        if f"_blocks.{i}._expand_conv.weight" in published:
            names.append((f"blocks.{i}.expand", f"_blocks.{i}._expand_conv", f"_blocks.{i}._bn0"))
        names.append((f"blocks.{i}.depthwise", f"_blocks.{i}._depthwise_conv", f"_blocks.{i}._bn1"))
        names.append((f"blocks.{i}.project", f"_blocks.{i}._project_conv", f"_blocks.{i}._bn2"))
    return names
