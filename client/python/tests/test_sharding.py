"""The partition of samples over ranks and workers, and exact resume."""

import itertools
import json
import pickle
import subprocess
import sys
import types

import pytest
from peer import SNAPSHOT, Fault

from backlot import Client, Recipe, ShardedSamples
from backlot.sharding import Shard, ranges, size

NUMBERS = list(itertools.product((0, 1, 7, 64, 101), (1, 2, 5), (1, 2, 3, 8), (1, 2, 4)))


def expand(shard_ranges):
    return [index for start, count in shard_ranges for index in range(start, start + count)]


def shards(world_size, num_workers):
    return [Shard(r, world_size, w, num_workers) for r in range(world_size) for w in range(num_workers)]


def partition_is_exact(of_shard, count, world_size, num_workers):
    """True if every index of [1000, 1000 + count) is in exactly one shard, in increasing order within it."""
    parts = [of_shard(shard) for shard in shards(world_size, num_workers)]
    return sorted(itertools.chain(*parts)) == list(range(1000, 1000 + count)) and all(p == sorted(p) for p in parts)


@pytest.mark.parametrize("count, block, world_size, num_workers", NUMBERS)
def test_no_sample_is_repeated_or_lost(count, block, world_size, num_workers):
    def of_shard(shard):
        part = expand(ranges(1000, 1000 + count, block, shard))
        assert len(part) == size(1000, 1000 + count, block, shard)
        return part

    assert partition_is_exact(of_shard, count, world_size, num_workers)


def test_the_check_of_a_partition_can_fail():
    # Each worker of a rank makes the rank's whole share: the classic mistake.
    def blind_to_workers(shard):
        return expand(ranges(1000, 1064, 2, Shard(shard.rank, shard.world_size, 0, 1)))

    assert partition_is_exact(blind_to_workers, 64, 4, 1)
    assert not partition_is_exact(blind_to_workers, 64, 4, 2)


@pytest.mark.parametrize("count, block, world_size, num_workers", NUMBERS)
def test_skipping_is_dropping_the_front(count, block, world_size, num_workers):
    for shard in shards(world_size, num_workers):
        whole = expand(ranges(5, 5 + count, block, shard))
        for skip in {0, 1, block, block + 1, len(whole), len(whole) + 3}:
            assert expand(ranges(5, 5 + count, block, shard, skip)) == whole[skip:]


def loader_batches(count, batch_size, rank, world_size, num_workers):
    """Batches in the order of torch's DataLoader: one from each worker in turn."""
    queues = []
    for worker in range(num_workers):
        mine = expand(ranges(0, count, batch_size, Shard(rank, world_size, worker, num_workers)))
        queues.append([mine[i : i + batch_size] for i in range(0, len(mine), batch_size)])
    return [batch for turn in itertools.zip_longest(*queues) for batch in turn if batch]


@pytest.mark.parametrize("world_size", [1, 3])
def test_the_order_of_batches_does_not_depend_on_the_number_of_workers(world_size):
    for rank in range(world_size):
        alone = loader_batches(96, 4, rank, world_size, num_workers=1)
        assert [loader_batches(96, 4, rank, world_size, n) for n in (2, 3, 5)] == [alone] * 3
    # The k-th batches of all ranks are the k-th block of samples.
    steps = zip(*(loader_batches(96, 4, rank, world_size, 2) for rank in range(world_size)))
    assert [sorted(sum(step, [])) for step in steps] == [
        list(range(k, k + 4 * world_size)) for k in range(0, 96, 4 * world_size)
    ]


def test_impossible_shards_are_refused():
    for numbers in ((2, 2, 0, 1), (-1, 2, 0, 1), (0, 1, 3, 3), (0, 0, 0, 1)):
        with pytest.raises(ValueError):
            Shard(*numbers)


def worker(worker_id, num_workers):
    """What torch.utils.data.get_worker_info() returns in a worker."""
    return types.SimpleNamespace(id=worker_id, num_workers=num_workers)


@pytest.fixture
def dataset(client, recipe):
    def make(**changes):
        arguments = {"seed": 3, "count": 24, "block_size": 2, "transform": lambda sample: sample.index} | changes
        return ShardedSamples(client, recipe, **arguments)

    return make


def test_workers_of_all_ranks_share_an_epoch(dataset):
    parts = [
        list(dataset(rank=rank, world_size=2, start=100).iterate(worker(w, 3))) for rank in range(2) for w in range(3)
    ]
    assert sorted(sum(parts, [])) == list(range(100, 124))


def test_epochs_are_different_samples(dataset):
    data = dataset()
    assert list(data.iterate()) == list(range(24))
    data.set_epoch(2)
    assert list(data.iterate()) == list(range(48, 72))
    assert list(data.iterate()) == list(range(48, 72))


@pytest.mark.parametrize("taken", [0, 1, 4, 7, 12])
@pytest.mark.parametrize("who", [None, worker(1, 2)])
def test_a_shard_resumes_exactly_where_its_state_was_taken(dataset, taken, who):
    first = dataset(rank=0, world_size=1)
    first.set_epoch(5)
    iterator = first.iterate(who)
    before = [next(iterator) for _ in range(taken)]
    state = json.loads(json.dumps(first.state_dict()))
    iterator.close()
    second = dataset(rank=0, world_size=1)
    second.load_state_dict(state)
    second.set_epoch(5)
    whole = list(dataset(start=5 * 24).iterate(who))
    assert before + list(second.iterate(who)) == whole
    # The next epoch is whole again.
    second.set_epoch(6)
    assert len(list(second.iterate(who))) == len(whole)


def test_a_run_resumes_with_other_numbers(dataset):
    # Three steps of batch 2 on two ranks, then one rank with three workers.
    state = dataset().state_after(3 * 2 * 2)
    rest = []
    for w in range(3):
        data = dataset()
        data.load_state_dict(state)
        rest += data.iterate(worker(w, 3))
    assert sorted(rest) == list(range(12, 24))


def test_a_state_of_one_shard_does_not_load_into_another(dataset):
    first = dataset(rank=0, world_size=2)
    next(first.iterate(worker(0, 2)))
    second = dataset(rank=1, world_size=2)
    second.load_state_dict(first.state_dict())
    with pytest.raises(ValueError, match="state_after"):
        next(second.iterate(worker(0, 2)))


def test_a_state_of_other_samples_is_refused(dataset):
    state = dataset().state_dict()
    for change in ({"seed": 4}, {"count": 25}, {"start": 1}, {"block_size": 1}):
        with pytest.raises(ValueError, match="another"):
            dataset(**change).load_state_dict(state)
    with pytest.raises(ValueError, match="version"):
        dataset().load_state_dict(state | {"version": 99})


def test_broken_connections_do_not_change_what_a_worker_sees(dataset, peer):
    peer.samples.faults = [Fault(1), Fault(0), Fault(1), Fault(2)]
    assert list(dataset().iterate(worker(1, 2))) == [2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23]


def test_ranks_come_from_the_environment(dataset, monkeypatch):
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "3")
    assert list(dataset().iterate()) == [2, 3, 8, 9, 14, 15, 20, 21]


def test_a_dataset_needs_a_snapshot(client):
    with pytest.raises(ValueError, match="snapshot"):
        ShardedSamples(client, Recipe(background="assets/street"), seed=1, count=1)


def test_a_dataset_pickles(peer, recipe):
    data = ShardedSamples(Client(peer.target), recipe, seed=3, count=4)
    assert [s.index for s in pickle.loads(pickle.dumps(data)).iterate()] == [0, 1, 2, 3]


TORCH_SHAPED = """
import sys, types
{setup}
import backlot
assert "torch" not in sys.modules or {present}, "importing backlot imported torch"
{use}
"""

FAKE_TORCH = """
torch, utils, data = (types.ModuleType(n) for n in ("torch", "torch.utils", "torch.utils.data"))
class IterableDataset: pass
data.IterableDataset, data.get_worker_info = IterableDataset, lambda: types.SimpleNamespace(id=1, num_workers=2)
sys.modules.update({"torch": torch, "torch.utils": utils, "torch.utils.data": data})
"""


def run_python(program):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)


def test_the_torch_dataset_asks_torch_for_its_worker(peer):
    """With modules of torch's names and shapes; the real DataLoader is not installed here."""
    use = f"""
recipe = backlot.Recipe(background="assets/street", library_snapshot="{SNAPSHOT}")
dataset = backlot.SampleDataset(backlot.Client("{peer.target}"), recipe, seed=1, count=6)
assert isinstance(dataset, IterableDataset)
print([sample.index for sample in dataset])
"""
    result = run_python(TORCH_SHAPED.format(setup=FAKE_TORCH, present=True, use=use))
    assert result.stdout.strip() == "[1, 3, 5]", result.stderr


def test_without_torch_only_the_dataset_fails():
    setup = "sys.modules['torch'] = None"
    result = run_python(TORCH_SHAPED.format(setup=setup, present=True, use="backlot.SampleDataset"))
    assert "pip install 'backlot[torch]'" in result.stderr
    result = run_python(TORCH_SHAPED.format(setup="", present=False, use="from backlot import *"))
    assert result.returncode == 0, result.stderr
