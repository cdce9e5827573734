"""The PyTorch dataset. Importing this module imports torch; importing `backlot` does not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

try:
    from torch.utils.data import IterableDataset, get_worker_info
except ImportError as error:
    raise ImportError("SampleDataset needs PyTorch: pip install 'backlot[torch]'") from error

from backlot.dataset import ShardedSamples


class SampleDataset(ShardedSamples, IterableDataset):
    """`ShardedSamples` for torch's DataLoader: each worker makes its share. Arguments and state are those of the base."""

    def __iter__(self) -> Iterator[Any]:
        return self.iterate(get_worker_info())
