"""Pretrained weights as people have them: half precision, no pooler, pointers, interrupted downloads, caches, git."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from pydantic import ValidationError
from test_vision import CPU, huggingface_folder, made, r3m_file, randomised  # noqa: F401
from torch import nn

from acgd.settings import Section
from acgd.store.key import content_digest, file_digest, in_key
from acgd.vision import backbones
from acgd.vision.huggingface.settings import HuggingFaceConfig
from acgd.vision.r3m.resnet import ResNet
from acgd.vision.r3m.settings import R3MConfig
from acgd.vision.settings import BackboneRequest

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 346293852\n"
VIT = {
    "hidden_size": 32,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
    "intermediate_size": 32,
    "image_size": 32,
    "patch_size": 16,
}


def vit(**settings):
    from transformers import ViTConfig, ViTModel

    return randomised(ViTModel(ViTConfig(**VIT), **settings))


def classifier():
    from transformers import ViTConfig, ViTForImageClassification

    return randomised(ViTForImageClassification(ViTConfig(**VIT)))


def convnext():
    from transformers import ConvNextConfig, ConvNextModel

    return randomised(ConvNextModel(ConvNextConfig(hidden_sizes=[8, 16, 16, 16], depths=[1, 1, 1, 1])))


def clip():
    from transformers import CLIPConfig, CLIPModel

    small = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
    tower, text = small | {"image_size": 32, "patch_size": 8}, small | {"vocab_size": 10}
    return randomised(CLIPModel(CLIPConfig(vision_config=tower, text_config=text, projection_dim=8)))


MODELS = {
    "pooler": vit,
    "no pooler": lambda: vit(add_pooling_layer=False),
    "classifier": classifier,
    "float16": lambda: vit().half(),
    "bfloat16": lambda: convnext().bfloat16(),
    "tower in float16": lambda: clip().half(),
}


@pytest.mark.parametrize("name", MODELS)
def test_the_same_folder_gives_the_same_bytes_in_float32(tmp_path, name):
    model: nn.Module = MODELS[name]()
    model.save_pretrained(tmp_path / "model")
    config, outs = HuggingFaceConfig(path=tmp_path / "model", size=32), []
    for seed in (0, 1):
        torch.manual_seed(seed)
        outs.append(made(tmp_path / str(seed), config))
    for file in ("backbone.safetensors", "backbone.json"):
        assert file_digest(outs[0] / file) == file_digest(outs[1] / file), file
    torch.manual_seed(2)
    images = torch.randint(0, 255, (2, 40, 40, 3), dtype=torch.uint8)
    loaded = [backbones.load(out, CPU) for out in outs]
    features = [backbone(images) for backbone in loaded]
    assert features[0].dtype == torch.float32 and torch.equal(*features) and torch.isfinite(features[0]).all()
    assert all(value.dtype == torch.float32 for value in loaded[0].parameters())
    stored = model.state_dict()
    if name == "float16":
        assert all(torch.equal(value, stored[key].float()) for key, value in loaded[0].model.state_dict().items())
    if name == "no pooler":
        expected = model(pixel_values=loaded[0].preprocess(images)).last_hidden_state.mean(1)
        assert torch.allclose(features[0], expected, atol=1e-5)


def test_missing_weights_are_never_drawn_at_random(tmp_path):
    from safetensors.torch import load_file, save_file

    vit().save_pretrained(tmp_path / "model")
    weights = load_file(tmp_path / "model/model.safetensors")
    absent = next(name for name in weights if "layernorm" in name)
    save_file({k: v for k, v in weights.items() if k != absent}, tmp_path / "model/model.safetensors", {"format": "pt"})
    with pytest.raises(ValueError, match="lack 1 tensors.*layernorm.*Download"):
        made(tmp_path, HuggingFaceConfig(path=tmp_path / "model", size=32))


def test_a_size_that_the_model_does_not_read_names_the_setting(tmp_path):
    vit().save_pretrained(tmp_path / "model")
    with pytest.raises(ValueError, match="64 pixels.*set backbone.size"):
        made(tmp_path, HuggingFaceConfig(path=tmp_path / "model", size=64))


@pytest.mark.parametrize("precision", [torch.float16, torch.bfloat16])
def test_r3m_of_half_precision_loads_in_float32(tmp_path, precision):
    weights = {f"module.convnet.{k}": v.to(precision) for k, v in randomised(ResNet(18)).state_dict().items()}
    torch.save({"r3m": weights}, tmp_path / "model.pt")
    loaded = backbones.load(made(tmp_path, R3MConfig(path=tmp_path / "model.pt", size=32)), CPU)
    assert all(value.dtype == torch.float32 for value in loaded.parameters())
    assert torch.equal(loaded.convnet.conv1.weight, weights["module.convnet.conv1.weight"].float())


def half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("../../blobs/0123.incomplete")


FAULTS = {
    "pointer": (lambda path: path.write_text(POINTER), "git-lfs pointer.*git lfs pull"),
    "interrupted": (half, "the download is incomplete"),
    "header cut": (lambda path: path.write_bytes(path.read_bytes()[:100]), "the download is incomplete"),
    "empty": (lambda path: path.write_bytes(b""), "is empty: the download is incomplete"),
    "page": (lambda path: path.write_text("<!DOCTYPE html><html>"), "is a web page"),
    "link": (dangling, "link to a file that does not exist|there is no file"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_files_are_refused_at_planning(tmp_path, huggingface_folder, r3m_file, fault):  # noqa: F811
    damage, message = FAULTS[fault]
    folder = shutil.copytree(huggingface_folder, tmp_path / "model")
    HuggingFaceConfig(path=folder)
    damage(folder / "model.safetensors")
    with pytest.raises(ValidationError, match=message):
        HuggingFaceConfig(path=folder)
    file = Path(shutil.copy(r3m_file, tmp_path / "model.pt"))
    R3MConfig(path=file)
    damage(file)
    with pytest.raises(ValidationError, match=message):
        R3MConfig(path=file)


def test_other_folders_are_refused_at_planning_with_their_mend(tmp_path, huggingface_folder):  # noqa: F811
    def refused(message: str, path: Path) -> None:
        with pytest.raises(ValidationError, match=message):
            HuggingFaceConfig(path=path)

    folder = shutil.copytree(huggingface_folder, tmp_path / "model")
    (folder / "preprocessor_config.json").write_text('{"image_mean": [0.5], "image_std": [0.5]}')
    refused("image_mean is .*three numbers", folder)
    (folder / "preprocessor_config.json").write_text(POINTER)
    refused("git lfs pull", folder)
    (folder / "preprocessor_config.json").unlink()
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")
    refused("no model.safetensors .it holds pytorch_model.bin.*save_pretrained", folder)
    (folder / "model.safetensors.index.json").write_text(
        json.dumps({"weight_map": {"a": "model-00001-of-1.safetensors"}})
    )
    refused("there is no file .*model-00001-of-1.safetensors: the download is incomplete", folder)
    (folder / "config.json").write_text('{"layers": 3}')
    refused("no model_type", folder)
    shutil.copytree(huggingface_folder, tmp_path / "models--a--b/snapshots/0123")
    refused(r"folder of the hub's cache: set backbone.path to its snapshot .*snapshots/0123", tmp_path / "models--a--b")


def test_sharded_weights_load(tmp_path):
    model = vit()
    model.save_pretrained(tmp_path / "model", max_shard_size="8KB")
    assert len(list((tmp_path / "model").glob("*.safetensors"))) > 1
    loaded = backbones.load(made(tmp_path, HuggingFaceConfig(path=tmp_path / "model", size=32)), CPU)
    assert all(torch.equal(value, model.state_dict()[name]) for name, value in loaded.model.state_dict().items())


def keyed(config: Section) -> dict:
    return in_key(BackboneRequest(backbone=config))["backbone"]["path"]


def test_the_key_follows_the_files_of_the_model_and_nothing_else(tmp_path, huggingface_folder):  # noqa: F811
    folder = shutil.copytree(huggingface_folder, tmp_path / "model")
    config = HuggingFaceConfig(path=folder)
    before = keyed(config)
    assert sorted(before) == ["config.json", "model.safetensors", "preprocessor_config.json"]
    for name in (".git/HEAD", ".gitattributes", ".cache/huggingface/download/a.metadata", "README.md", "tf_model.h5",
                 "onnx/model.onnx", "pytorch_model.bin", "snapshots/1/config.json"):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("other")
    assert keyed(config) == before
    blobs = tmp_path / "models--a--b/blobs"
    blobs.mkdir(parents=True), (tmp_path / "models--a--b/snapshots/1").mkdir(parents=True)
    for name in before:  # as the hub's cache keeps them
        shutil.copy(folder / name, blobs / f"blob-{name}")
        (tmp_path / "models--a--b/snapshots/1" / name).symlink_to(f"../../blobs/blob-{name}")
    assert keyed(HuggingFaceConfig(path=tmp_path / "models--a--b/snapshots/1")) == before
    for name in before:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content.replace(b'"', b' "', 1) if name.endswith("json") else content[:-1] + b"!")
        assert keyed(config)[name] != before[name]
        (folder / name).write_bytes(content)


def test_hidden_files_of_a_folder_have_no_digest(tmp_path):
    for name in ("a.txt", "b/c.txt", ".git/HEAD", "b/.DS_Store"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    assert list(content_digest(tmp_path)) == ["a.txt", "b/c.txt"]
