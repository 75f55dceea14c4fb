"""Weights of a task's reward terms."""


def merge_weights(task: str, weights: dict[str, float], changed: dict[str, float] | None) -> dict[str, float]:
    """The default weights with those of `changed` replaced. ValueError for a term that the task does not have."""
    unknown = set(changed or {}) - set(weights)
    if unknown:
        raise ValueError(f"{task} has no reward term {sorted(unknown)}; its terms are {sorted(weights)}")
    return dict(weights) | dict(changed or {})
