"""Checks of the arguments of an environment: action, options, render mode. An error names the fault and its mend."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

RENDER_MODES = ("rgb_array",)


def checked_action(task: str, action: Any, size: int, dtype: DTypeLike) -> np.ndarray:
    """The action (size,) with the given type. ValueError for another shape and for entries that are not finite."""
    try:
        array = np.asarray(action, dtype)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{task} takes actions of {size} numbers, not {action!r:.60} ({error})") from error
    if array.shape != (size,):
        raise ValueError(
            f"{task} takes an action of shape ({size},), not {array.shape}: pass one number in [-1, 1] per actuator, "
            "and one action per environment"
        )
    if not np.isfinite(array).all():
        at = int(np.flatnonzero(~np.isfinite(array))[0])
        fault = "not a number" if np.isnan(array[at]) else "infinite"
        raise ValueError(
            f"{task} was given an action whose entry {at} is {fault}: look for the fault in the policy, such as a "
            "diverged training or observations that are not finite"
        )
    return array


def checked_advance(task: str, options: Mapping[str, Any] | None, *, advances: bool) -> float:
    """The option `advance` of a reset, a share in [0, 1]; 0 by default. ValueError for other options.

    advances: whether the task has starts on the way to its goal.
    """
    if options is None:
        return 0.0
    if not isinstance(options, Mapping):
        raise ValueError(f"{task} takes options as a dict, not {options!r:.60}")
    valid = ("advance",) if advances else ()
    unknown = [str(name) for name in options if name not in valid]
    if unknown:
        known = f"its options are: {', '.join(valid)}" if valid else "it has none"
        raise ValueError(f"{task} does not know the option {', '.join(unknown)}; {known}. Leave it out")
    share = options.get("advance")
    if share is None:
        return 0.0
    try:
        value = float(share)
    except (TypeError, ValueError):
        value = math.nan
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{task}: the option advance is {share!r:.60}; it is a share of the way in [0, 1]")
    return value


def checked_render_mode(task: str, mode: str | None) -> str | None:
    """The render mode `rgb_array` or None. ValueError for another."""
    if mode is not None and mode not in RENDER_MODES:
        raise ValueError(
            f"{task} does not draw in render_mode {mode!r}: use render_mode='rgb_array', "
            "and show the arrays of render() in a window of your own"
        )
    return mode
