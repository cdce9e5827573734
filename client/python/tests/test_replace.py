"""Replacing images of a batch."""

import pytest

from backlot import replace_in_batch

ITEMS = [("in", n) if n % 2 else ("out", n) for n in range(40)]


def replaced(client, recipe, items, position=0, probability=0.5):
    return replace_in_batch(
        client, items, scene_of=lambda item: item[0], recipes={"in": recipe}, convert=lambda s: s.index,
        probability=probability, seed=11, position=position,
    )  # fmt: skip


def test_some_items_of_known_scenes_are_replaced_by_their_own_sample(client, recipe):
    batch = replaced(client, recipe, ITEMS)
    taken = [n for n, item in enumerate(batch) if item == n]
    kept = [n for n, item in enumerate(batch) if item == ITEMS[n]]
    assert sorted(taken + kept) == list(range(40))
    assert all(n % 2 for n in taken) and 4 <= len(taken) <= 16


def test_the_choice_depends_on_the_position_in_the_run_not_on_the_batches(client, recipe):
    halves = replaced(client, recipe, ITEMS[:13]) + replaced(client, recipe, ITEMS[13:], position=13)
    assert halves == replaced(client, recipe, ITEMS)
    assert replaced(client, recipe, ITEMS, position=1) != replaced(client, recipe, ITEMS)


def test_the_extremes(client, recipe):
    assert replaced(client, recipe, ITEMS, probability=0.0) == ITEMS
    assert replaced(client, recipe, ITEMS, probability=1.0) == [n if n % 2 else ITEMS[n] for n in range(40)]
    with pytest.raises(ValueError):
        replaced(client, recipe, ITEMS, probability=1.1)
