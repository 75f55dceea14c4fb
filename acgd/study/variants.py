"""Variants of a study: overrides of the base. Lists under `expand` give several variants."""

import itertools
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

EXPAND = "expand"

Place = tuple[str, ...]


def expanded(variants: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Name -> override, with each `{expand: [...]}` replaced by one of its values.

    `demos: {rollouts: {demonstrations: {expand: [10, 30]}}}` gives `demos-demonstrations-10` and
    `demos-demonstrations-30`. Several lists in one variant give every combination. Raises ValueError of a malformed
    `expand` or a repeated name.
    """
    named: dict[str, dict[str, Any]] = {}
    for name, override in variants.items():
        lists = list(_lists(override))
        for choice in itertools.product(*(values for _, values in lists)):
            parts = [f"{place[-1]}-{_slug(value)}" for (place, _), value in zip(lists, choice, strict=True)]
            full = "-".join([name, *parts])
            if full in named and lists:
                listed = ", ".join(f"{'.'.join(place)}: {values}" for place, values in lists)
                raise ValueError(
                    f"two variants have the name {full!r}. Take values with distinct names in {EXPAND} ({listed})."
                )
            if full in named:
                raise ValueError(f"two variants have the name {full!r}. Rename one of them.")
            chosen = dict(override)
            for (place, _), value in zip(lists, choice, strict=True):
                chosen = _replaced(chosen, place, value)
            named[full] = chosen
    return named


def _lists(value: Any, place: Place = ()) -> Iterator[tuple[Place, list[Any]]]:
    """(place, values) of every `expand` in an override."""
    if not isinstance(value, Mapping):
        return
    if EXPAND in value:
        values = value[EXPAND]
        if set(value) != {EXPAND} or not isinstance(values, list) or not values or not place:
            where = ".".join(place) or "the variant"
            raise ValueError(
                f"{where}: {EXPAND} is malformed. Write {{{EXPAND}: [first, second, ...]}} in place of one value, and "
                "no other key beside it."
            )
        yield place, values
        return
    for name, item in value.items():
        yield from _lists(item, (*place, str(name)))


def _replaced(override: Mapping[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """A copy of `override` with `value` at `place`."""
    head, *rest = place
    return {**override, head: _replaced(override[head], tuple(rest), value) if rest else value}


def _slug(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    if isinstance(value, int | float) and value < 0:
        text = f"minus{text}"
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-") or "none"
