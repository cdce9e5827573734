"""Samples for a training loop: sharded over ranks and workers, resumable exactly. Needs no torch; see `backlot.torch`."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from backlot import sharding
from backlot.client import Client
from backlot.recipe import Recipe
from backlot.sample import Sample
from backlot.sharding import Shard

_STATE_VERSION = 1


class WorkerInfo(Protocol):
    """What `torch.utils.data.get_worker_info()` returns inside a worker."""

    id: int
    num_workers: int


class ShardedSamples:
    """An epoch is `count` samples of a recipe; epoch e covers indices start + e * count onwards.

    Which samples a run sees depends on (recipe, seed, start, count, epoch) alone. With `block_size` set to the loader's
    batch_size their order does not depend on num_workers either. Ranks get equally many samples if count is a multiple of
    world_size * block_size; otherwise none is repeated or dropped and the last block of some ranks is short or absent.

    Args:
        client: pickled or forked into each worker, where it opens its own channel.
        recipe: must name its library snapshot, so that all ranks and every resumed run draw from the same library.
        seed: 0 .. 2^64 - 1.
        count: samples an epoch, over all ranks.
        start: index of the first sample of epoch 0.
        block_size: consecutive samples that one worker makes; the loader's batch_size.
        rank, world_size: this process among the job's; by default the environment's RANK and WORLD_SIZE (as torchrun sets
            them), else a single rank.
        transform: turns a `Sample` into what the loader shall collate; runs in the worker.
        prefetch: samples that each worker reads ahead of its loader.
    """

    def __init__(
        self,
        client: Client,
        recipe: Recipe,
        *,
        seed: int,
        count: int,
        start: int = 0,
        block_size: int = 1,
        rank: int | None = None,
        world_size: int | None = None,
        transform: Callable[[Sample], Any] | None = None,
        prefetch: int = 4,
    ):
        if not recipe.library_snapshot:
            raise ValueError("the recipe names no library snapshot: use recipe.pinned(client.create_snapshot().name)")
        if count < 1 or start < 0 or block_size < 1 or prefetch < 1:
            raise ValueError(
                f"count {count}, start {start}, block_size {block_size} or prefetch {prefetch} is too small"
            )
        self._client = client
        self._recipe = recipe
        self._seed = seed
        self._count = count
        self._start = start
        self._block_size = block_size
        self._rank = int(os.environ.get("RANK", 0)) if rank is None else rank
        self._world_size = int(os.environ.get("WORLD_SIZE", 1)) if world_size is None else world_size
        self._transform = transform
        self._prefetch = prefetch
        self.epoch = 0
        # Samples of this epoch, over all ranks, that were consumed before the present sharding began.
        self._base = 0
        # The shard being iterated and how many samples it has yielded since `_base`; None before iteration.
        self._shard: Shard | None = None
        self._yielded = 0
        # Set by load_state_dict until the next iteration, for a state that belongs to one shard.
        self._resuming = False
        Shard(self._rank, self._world_size, 0, 1)

    def set_epoch(self, epoch: int) -> None:
        """Chooses the epoch of the next iteration. Call it before each; a loaded state of the same epoch is kept."""
        if epoch < 0:
            raise ValueError(f"epoch must not be negative: {epoch}")
        if epoch != self.epoch:
            self.epoch = epoch
            self._base, self._shard, self._yielded, self._resuming = 0, None, 0, False

    def iterate(self, worker: WorkerInfo | None = None) -> Iterator[Any]:
        """The samples of this rank, or of one of its workers."""
        shard = Shard(self._rank, self._world_size, worker.id if worker else 0, worker.num_workers if worker else 1)
        skip = self._begin(shard)
        first = self._start + self.epoch * self._count
        ranges = sharding.ranges(first + self._base, first + self._count, self._block_size, shard, skip)
        stream = self._client.stream_ranges(self._recipe, seed=self._seed, ranges=ranges, prefetch=self._prefetch)
        with stream:
            for sample in stream:
                # Counted before it is handed out, so that a state taken while the consumer holds it comes after it.
                self._yielded += 1
                yield self._transform(sample) if self._transform else sample

    def state_dict(self) -> dict[str, Any]:
        """The state of the copy that iterates: after the last sample yielded by this shard.

        Taken inside a worker (as torchdata's StatefulDataLoader does) or without workers, and loaded into the same sharding. For
        a loader whose workers cannot be asked, or to go on with other numbers, use `state_after`.
        """
        shard = self._shard and [
            self._shard.rank, self._shard.world_size, self._shard.worker_id, self._shard.num_workers
        ]  # fmt: skip
        return self._state(self._base, shard, self._yielded)

    def state_after(self, samples: int) -> dict[str, Any]:
        """The state after the first `samples` of the epoch, counted over all ranks: batches * batch_size * world_size.

        Loads into any number of ranks and workers. Exact if block_size is the loader's batch_size.
        """
        if not 0 <= samples <= self._count:
            raise ValueError(f"samples must be in 0..{self._count}, not {samples}")
        return self._state(samples, None, 0)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Makes the next iteration go on where `state` was taken; ValueError if it belongs to other samples."""
        if state.get("version") != _STATE_VERSION:
            raise ValueError(f"state version {state.get('version')} is not {_STATE_VERSION}")
        if state["fingerprint"] != self._fingerprint():
            raise ValueError("the state belongs to another recipe, snapshot, seed, start, count or block_size")
        self.epoch = state["epoch"]
        self._base = state["base"]
        self._shard = Shard(*state["shard"]) if state["shard"] else None
        self._yielded = state["yielded"]
        self._resuming = True

    def _begin(self, shard: Shard) -> int:
        """Starts an iteration over `shard` and returns how many of its samples to skip."""
        resuming, self._resuming = self._resuming, False
        if not resuming:
            self._base, self._yielded = 0, 0
        elif self._shard is not None and self._shard != shard:
            raise ValueError(f"the state is of {self._shard}, this is {shard}; use state_after to change the numbers")
        self._shard = shard
        return self._yielded

    def _state(self, base: int, shard: list[int] | None, yielded: int) -> dict[str, Any]:
        return {
            "version": _STATE_VERSION,
            "fingerprint": self._fingerprint(),
            "epoch": self.epoch,
            "base": base,
            "shard": shard,
            "yielded": yielded,
        }

    def _fingerprint(self) -> str:
        what = f"{self._recipe.fingerprint()}/{self._seed}/{self._start}/{self._count}/{self._block_size}"
        return hashlib.blake2b(what.encode(), digest_size=16).hexdigest()
