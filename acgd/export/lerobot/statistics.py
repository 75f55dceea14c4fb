"""Statistics of features in the form of LeRobot, for each episode and for the dataset."""

from collections.abc import Sequence

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
IMAGES_AT_MOST = 20
"""Most frames of an episode for the statistics of its images."""

Statistics = dict[str, np.ndarray]
"""min, max, mean, std, the quantiles, each (D,) or (3, 1, 1), and count (1,)."""


def of_rows(rows: np.ndarray) -> Statistics:
    """Statistics of rows (T, D), or (T,) for a feature of one number."""
    values = rows.reshape(len(rows), -1).astype(np.float64)
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    return {
        "min": values.min(0),
        "max": values.max(0),
        "mean": values.mean(0),
        "std": values.std(0),
        **dict(zip(QUANTILES, quantiles)),
        "count": np.array([len(values)]),
    }


def of_images(images: np.ndarray) -> Statistics:
    """Statistics of the channels (3, 1, 1) in [0, 1] of images (T, H, W, 3) uint8, over evenly spaced frames."""
    chosen = np.unique(np.linspace(0, len(images) - 1, min(len(images), IMAGES_AT_MOST)).round().astype(int))
    of_pixels = of_rows(images[chosen].reshape(-1, 3))
    scaled = {name: (value / 255).reshape(3, 1, 1) for name, value in of_pixels.items() if name != "count"}
    return scaled | {"count": np.array([len(chosen)])}


def joined(parts: Sequence[Statistics]) -> Statistics:
    """Statistics of all episodes. As in LeRobot, quantiles are weighted means over episodes, hence approximate."""
    count = np.stack([part["count"] for part in parts])
    weight = count.reshape(len(parts), *(1,) * parts[0]["mean"].ndim) / count.sum()
    mean = sum(w * part["mean"] for w, part in zip(weight, parts))
    variance = sum(w * (part["std"] ** 2 + (part["mean"] - mean) ** 2) for w, part in zip(weight, parts))
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        **{name: sum(w * part[name] for w, part in zip(weight, parts)) for name in QUANTILES},
        "count": count.sum(0),
    }
