"""The registry of backbones: one line and one folder per kind. The code is a class like `Backbone` in backbones.py."""

from acgd.settings import Kind

BACKBONES: dict[str, Kind] = {
    "privileged": Kind(
        "acgd.vision.privileged.settings:PrivilegedConfig", "acgd.vision.privileged.backbone:Privileged"
    ),
    "scratch": Kind("acgd.vision.scratch.settings:ScratchConfig", "acgd.vision.scratch.backbone:Scratch"),
    "imagenet": Kind("acgd.vision.imagenet.settings:ImageNetConfig", "acgd.vision.imagenet.backbone:ImageNet"),
    "r3m": Kind("acgd.vision.r3m.settings:R3MConfig", "acgd.vision.r3m.backbone:R3M"),
    "huggingface": Kind(
        "acgd.vision.huggingface.settings:HuggingFaceConfig", "acgd.vision.huggingface.backbone:HuggingFace"
    ),
}
