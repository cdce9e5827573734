"""Who makes which samples: a partition of an index range over ranks and their DataLoader workers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator


@dataclasses.dataclass(frozen=True)
class Shard:
    """One reader among `world_size` ranks with `num_workers` workers each; both numbers are at least 1."""

    rank: int
    world_size: int
    worker_id: int
    num_workers: int

    def __post_init__(self):
        if not 0 <= self.rank < self.world_size:
            raise ValueError(f"rank {self.rank} is not in 0..{self.world_size - 1}")
        if not 0 <= self.worker_id < self.num_workers:
            raise ValueError(f"worker {self.worker_id} is not in 0..{self.num_workers - 1}")

    @property
    def lanes(self) -> int:
        """Readers in all."""
        return self.world_size * self.num_workers

    @property
    def lane(self) -> int:
        """Place of this reader in the order in which blocks are dealt.

        A DataLoader takes one batch from each worker in turn, so block k * world_size + rank is a rank's k-th batch: the order
        of batches does not depend on num_workers, and the k-th batches of all ranks are neighbours.
        """
        return self.worker_id * self.world_size + self.rank


def ranges(start: int, end: int, block_size: int, shard: Shard, skip: int = 0) -> Iterator[tuple[int, int]]:
    """The (start, count) ranges of one shard of [start, end), in order, without its first `skip` indices.

    Blocks of `block_size` are dealt to the shards in turn. Over all shards every index occurs exactly once, whatever the numbers.
    """
    if block_size < 1:
        raise ValueError(f"block_size must be at least 1, not {block_size}")
    if shard.lanes == 1:
        if start + skip < end:
            yield start + skip, end - start - skip
        return
    first = start + shard.lane * block_size
    for block in range(first, end, shard.lanes * block_size):
        count = min(block_size, end - block)
        if skip < count:
            yield block + skip, count - skip
        skip = max(skip - count, 0)


def size(start: int, end: int, block_size: int, shard: Shard) -> int:
    """How many indices `ranges` covers."""
    stride = shard.lanes * block_size
    whole, rest = divmod(max(end - start, 0), stride)
    return whole * block_size + min(max(rest - shard.lane * block_size, 0), block_size)
