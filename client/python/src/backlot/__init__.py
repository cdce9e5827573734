"""Labelled, augmented driving scenes from a Backlot server.

`Client` talks to the server, `Recipe` says what to make, `Sample` is what comes. `SampleDataset` feeds PyTorch; it is
imported on first use, so that the package itself does not need torch.
"""

from typing import TYPE_CHECKING

# First: it must set gRPC's fork support before gRPC is imported.
from backlot import fork as _fork
from backlot.actors import Clip, FollowActor, GivenObject, RemoveActor, ShiftActor, Waypoint
from backlot.client import Client
from backlot.dataset import ShardedSamples
from backlot.errors import (
    AlreadyExistsError,
    BacklotError,
    CancelledError,
    ContractError,
    DataLossError,
    DeadlineExceededError,
    FailedPreconditionError,
    ForkError,
    InternalError,
    InvalidArgumentError,
    NotFoundError,
    PermissionDeniedError,
    ResourceExhaustedError,
    UnavailableError,
    UnimplementedError,
)
from backlot.recipe import Recipe
from backlot.replace import replace_in_batch
from backlot.resources import Asset, DriveLog, Job, LibrarySnapshot, Quality
from backlot.sample import Box2D, Box3D, Frame, Provenance, Sample
from backlot.stream import SampleStream
from backlot.transport import Retry, Tls

if TYPE_CHECKING:
    from backlot.torch import SampleDataset

__all__ = [
    "AlreadyExistsError",
    "Asset",
    "BacklotError",
    "Box2D",
    "Box3D",
    "CancelledError",
    "Client",
    "Clip",
    "ContractError",
    "DataLossError",
    "DeadlineExceededError",
    "DriveLog",
    "FailedPreconditionError",
    "FollowActor",
    "ForkError",
    "Frame",
    "GivenObject",
    "InternalError",
    "InvalidArgumentError",
    "Job",
    "LibrarySnapshot",
    "NotFoundError",
    "PermissionDeniedError",
    "Provenance",
    "Quality",
    "Recipe",
    "RemoveActor",
    "ResourceExhaustedError",
    "Retry",
    "Sample",
    "SampleStream",
    "ShardedSamples",
    "ShiftActor",
    "Tls",
    "UnavailableError",
    "UnimplementedError",
    "Waypoint",
    "replace_in_batch",
]


def __getattr__(name: str):
    if name == "SampleDataset":
        from backlot.torch import SampleDataset

        return SampleDataset
    raise AttributeError(f"module 'backlot' has no attribute '{name}'")
