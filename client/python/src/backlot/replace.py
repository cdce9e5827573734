"""The paper's use of generated images: some images of a batch are replaced by augmented ones of the same scene."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from backlot.client import Client
from backlot.recipe import Recipe
from backlot.sample import Sample


def replace_in_batch(
    client: Client,
    batch: Sequence[Any],
    *,
    scene_of: Callable[[Any], str],
    recipes: Mapping[str, Recipe],
    convert: Callable[[Sample], Any],
    probability: float,
    seed: int,
    position: int,
) -> list[Any]:
    """The batch with each item whose scene is in the library replaced, with `probability`, by an augmented sample of it.

    Args:
        scene_of: the scene (driving log) of an item.
        recipes: a recipe with its snapshot for the background of each scene in the library.
        convert: makes an item of a sample.
        seed: of the samples and of the choice of items.
        position: number of items seen before this batch in the whole run. Item i uses sample position + i and its own
            random draw, so that a resumed run replaces the same items by the same samples.
    """
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"probability must be in 0..1, not {probability}")
    out = []
    for index, item in enumerate(batch, start=position):
        recipe = recipes.get(scene_of(item))
        if recipe is not None and random.Random(f"{seed}/{index}").random() < probability:
            item = convert(client.get_sample(recipe, seed=seed, index=index))
        out.append(item)
    return out
