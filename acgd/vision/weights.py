"""Files of pretrained weights as people have them: checks without torch, at planning. An error names fault and mend."""

import json
import math
import zipfile
from pathlib import Path
from typing import Any

_POINTER = b"version https://git-lfs.github.com/spec/"
_PICKLE = b"\x80"
_HEADER_LIMIT = 100_000_000
"""Largest header of a safetensors file in bytes, as in safetensors itself."""


def check_present(path: Path) -> None:
    """ValueError where the file is absent, empty, a git-lfs pointer or a web page."""
    if path.is_symlink() and not path.exists():
        raise ValueError(f"{path} is a link to a file that does not exist: the download is incomplete. Repeat it.")
    if not path.is_file():
        raise ValueError(f"there is no file {path}: the download is incomplete. Repeat it.")
    with open(path, "rb") as file:
        start = file.read(64)
    if start.startswith(_POINTER):
        raise ValueError(f"{path} is a git-lfs pointer and not the file itself: run `git lfs pull` in {path.parent}.")
    if not start.strip():
        raise ValueError(f"{path} is empty: the download is incomplete. Repeat it.")
    if start.lstrip().lower().startswith((b"<!doctype", b"<html")):
        raise ValueError(f"{path} is a web page and not the file itself: download the file behind the page.")


def check_safetensors(path: Path) -> None:
    """ValueError where the file is no whole safetensors file. Reads its header only."""
    check_present(path)
    size = path.stat().st_size
    with open(path, "rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = file.read(length) if length <= _HEADER_LIMIT else b""
    expected = 8 + length
    try:
        if len(header) == length:
            tensors = [entry for name, entry in json.loads(header).items() if name != "__metadata__"]
            expected += max((entry["data_offsets"][1] for entry in tensors), default=0)
        elif not header.startswith(b"{"):
            raise ValueError("no header")
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is no safetensors file. Write the model with save_pretrained.") from error
    if size != expected:
        raise ValueError(f"{path} has {size} of {expected} bytes: the download is incomplete. Repeat it.")


def check_torch(path: Path) -> None:
    """ValueError where the file is no whole file of torch.save. Reads its start and its list of contents only."""
    check_present(path)
    with open(path, "rb") as file:
        start = file.read(4)
    if start == b"PK\x03\x04" and not zipfile.is_zipfile(path):
        raise ValueError(f"{path} ends early: the download is incomplete. Repeat it.")
    if start != b"PK\x03\x04" and not start.startswith(_PICKLE):
        raise ValueError("it was not written by torch.save.")


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file. ValueError where there is none."""
    check_present(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no JSON file ({error}): the download is incomplete. Repeat it.") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no JSON object: the download is incomplete. Repeat it.")
    return content


def model_files(folder: Path) -> list[Path]:
    """Files of a `transformers` folder that define the model: configuration, image statistics, safetensors weights.

    ValueError where a file is absent, incomplete or of another format.
    """
    config = folder / "config.json"
    if "model_type" not in read_json(config):
        raise ValueError(f"{config} has no model_type: it is no configuration of a transformers model.")
    files = [config]
    if (folder / "preprocessor_config.json").exists():
        files.append(folder / "preprocessor_config.json")
        statistics(folder)
    whole, index = folder / "model.safetensors", folder / "model.safetensors.index.json"
    if whole.exists() or whole.is_symlink():
        weights = [whole]
    elif index.exists() or index.is_symlink():
        shards = read_json(index).get("weight_map")
        if not isinstance(shards, dict) or not shards:
            raise ValueError(f"{index} has no weight_map: the download is incomplete. Repeat it.")
        weights = [folder / name for name in sorted(set(shards.values()))]
        files.append(index)
    else:
        others = sorted(path.name for pattern in ("*.bin", "*.safetensors") for path in folder.glob(pattern))
        held = f"it holds {', '.join(others)}" if others else "the download is incomplete, or a copy left it out"
        raise ValueError(
            f"{folder} has no model.safetensors ({held}). Load the model with transformers and write it with "
            "save_pretrained."
        )
    for path in weights:
        check_safetensors(path)
    return files + weights


def statistics(folder: Path) -> tuple[list[float] | None, list[float] | None]:
    """Channel means and standard deviations of preprocessor_config.json; None for those that it does not hold."""
    file = folder / "preprocessor_config.json"
    stored = read_json(file) if file.exists() else {}
    mean, std = (stored.get(name) for name in ("image_mean", "image_std"))
    for name, value in (("image_mean", mean), ("image_std", std)):
        if value is not None and not (isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))):
            raise ValueError(
                f"{file}: {name} is {value!r:.60}, and this backbone reads RGB images: give three numbers."
            )
    if std is not None and min(std) <= 0:
        raise ValueError(f"{file}: image_std is {std}: give three positive numbers.")
    return mean, std


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
