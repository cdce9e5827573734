"""A network peer for tests of streaming, resuming and sharding: answers with samples computed from their index.

It stands for the other end of the wire only; what a server renders is tested against a real one in test_end_to_end.py.
Run as a program (optionally with the paths of a TLS key and certificate) it prints its port and serves until its standard
input ends.
"""

from __future__ import annotations

import io
import sys
import threading
from concurrent import futures

import grpc
import numpy as np
from google.protobuf import any_pb2, duration_pb2
from google.rpc import error_details_pb2, status_pb2
from PIL import Image

from backlot.v1 import assets_pb2, assets_pb2_grpc, common_pb2, samples_pb2, samples_pb2_grpc

SNAPSHOT = "librarySnapshots/" + "5" * 64
WIDTH, HEIGHT = 32, 20
DEPTH_UNIT_M = 1 / 256


class Fault:
    """Ends one call after `after` samples: with a status, without one (`code` None), or by never going on (`hang`)."""

    def __init__(self, after, code=grpc.StatusCode.UNAVAILABLE, details=(), hang=False):
        self.after, self.code, self.details, self.hang = after, code, details, hang


class Samples(samples_pb2_grpc.SampleServiceServicer):
    def __init__(self):
        self.faults: list[Fault] = []
        self.calls: list[tuple[int, int]] = []
        self.sent = 0
        self.shift = 0
        self.snapshot = SNAPSHOT
        self.padding_bytes = 0
        self.running = 0
        self.max_running = 100

    def StreamSamples(self, request, context):
        if self.running >= self.max_running:
            _fail(Fault(0, grpc.StatusCode.RESOURCE_EXHAUSTED, [retry_info(0.01)]), context)
        self.running += 1
        context.add_callback(self._ended)
        self.calls.append((request.start_index, request.count))
        fault = self.faults.pop(0) if self.faults else None
        for n in range(request.count):
            if fault and n == fault.after:
                return _fail(fault, context)
            sample = make_sample(request.start_index + n + self.shift, request.seed, self.snapshot)
            sample.provenance.render_class = "x" * self.padding_bytes
            self.sent += 1
            yield samples_pb2.StreamSamplesResponse(sample=sample)
        if fault and fault.after == request.count:
            _fail(fault, context)

    def _ended(self):
        self.running -= 1


class Assets(assets_pb2_grpc.AssetServiceServicer):
    """Lists five assets, two a page."""

    def __init__(self):
        self.failures = 0
        self.metadata: dict[str, str] = {}

    def ListAssets(self, request, context):
        self.metadata = dict(context.invocation_metadata())
        if self.failures > 0:
            self.failures -= 1
            context.abort(grpc.StatusCode.UNAVAILABLE, "away")
        first = int(request.page_token or 0)
        assets = [
            assets_pb2.Asset(
                name=f"assets/{i}", kind=assets_pb2.ASSET_KIND_OBJECT, object_class=common_pb2.OBJECT_CLASS_VAN
            )
            for i in range(first, min(first + 2, 5))
        ]
        return assets_pb2.ListAssetsResponse(assets=assets, next_page_token=str(first + 2) if first + 2 < 5 else "")

    def GetAsset(self, request, context):
        _fail(
            Fault(
                0,
                grpc.StatusCode.NOT_FOUND,
                (
                    error_details_pb2.ErrorInfo(
                        reason="ASSET_UNKNOWN", domain="backlot", metadata={"asset": request.name}
                    ),
                    error_details_pb2.BadRequest(
                        field_violations=[
                            error_details_pb2.BadRequest.FieldViolation(field="name", description="unknown")
                        ]
                    ),
                ),
            ),
            context,
        )

    def CreateLibrarySnapshot(self, request, context):
        return assets_pb2.CreateLibrarySnapshotResponse(library_snapshot=assets_pb2.LibrarySnapshot(name=SNAPSHOT))


class Peer:
    """A server on a free loopback port."""

    def __init__(self, credentials=None, port=0):
        self.samples, self.assets = Samples(), Assets()
        # reuse_port would let a second peer share the port silently.
        self._server = grpc.server(futures.ThreadPoolExecutor(32), options=[("grpc.so_reuseport", 0)])
        samples_pb2_grpc.add_SampleServiceServicer_to_server(self.samples, self._server)
        assets_pb2_grpc.add_AssetServiceServicer_to_server(self.assets, self._server)
        address = f"127.0.0.1:{port}"
        if credentials:
            self.port = self._server.add_secure_port(address, credentials)
        else:
            self.port = self._server.add_insecure_port(address)
        self.target = f"127.0.0.1:{self.port}"
        self._server.start()

    def stop(self):
        self._server.stop(0).wait()


def make_sample(index: int, seed: int, snapshot: str = SNAPSHOT) -> samples_pb2.Sample:
    """One camera, one inserted car 10 m ahead; every pixel and number is known."""
    instance = np.zeros((HEIGHT, WIDTH), np.uint16)
    instance[8:14, 10:20] = 300
    depth = np.full((HEIGHT, WIDTH), 40 * 256, np.uint16)
    depth[instance > 0] = 9 * 256 + 128
    depth[0] = 0
    ignore = np.zeros((HEIGHT, WIDTH), np.uint8)
    ignore[:, :3] = 255
    size = common_pb2.Vector3(x=4, y=2, z=1.5)
    # Drives away from the camera: cuboid x is camera z, cuboid y is minus camera x.
    away = common_pb2.Quaternion(w=0.5, x=0.5, y=-0.5, z=0.5)
    return samples_pb2.Sample(
        index=index,
        frames=[
            samples_pb2.SampleFrame(
                camera_id="front",
                frame_index=index % 7,
                view=samples_pb2.CameraView(
                    width=WIDTH, height=HEIGHT, focal_x_px=30, focal_y_px=31, principal_x_px=16, principal_y_px=10,
                    world_from_camera=_rigid(_inverse(away), 1, 2, 3),
                ),
                world_from_ego=_rigid(common_pb2.Quaternion(w=1), 1, 2, 3),
                image_png=_png(image_of(index, seed)),
                depth_png=_png(depth),
                depth_unit_m=DEPTH_UNIT_M,
                instance_png=_png(instance),
                ignore_png=_png(ignore),
                boxes_2d=[
                    samples_pb2.SampleBox2D(
                        instance_id=300,
                        amodal=common_pb2.Box2D(x_min=9.5, y_min=8, x_max=20, y_max=14),
                        visible_pixels=60, visible_fraction=1,
                        camera_from_cuboid=_rigid(away, 0, 0, 10),
                        world_from_cuboid=_rigid(common_pb2.Quaternion(w=1), 11, 2, 3),
                        ego_from_cuboid=_rigid(common_pb2.Quaternion(w=1), 10, 0, 0),
                        velocity_mps=common_pb2.Vector3(x=5),
                        mask_runs=runs_of(instance == 300),
                    )
                ],
            )
        ],
        boxes_3d=[
            samples_pb2.SampleBox(
                instance_id=300, origin=samples_pb2.BOX_ORIGIN_INSERTED, object_class=common_pb2.OBJECT_CLASS_CAR,
                cuboid=common_pb2.Cuboid(world_from_cuboid=_rigid(common_pb2.Quaternion(w=1), 11, 2, 3), size_m=size),
                asset="assets/car",
            )
        ],
        provenance=samples_pb2.SampleProvenance(library_snapshot=snapshot, background="assets/street", seed=seed),
        rejections={"collision": 2},
    )  # fmt: skip


def runs_of(mask: np.ndarray) -> list[int]:
    """Lengths of the alternating runs of a mask read down its columns, the first of them outside."""
    flat = np.concatenate([[False], mask.T.ravel()])
    changes = np.flatnonzero(np.diff(flat))
    return np.diff([0, *changes, mask.size]).tolist()


def image_of(index: int, seed: int) -> np.ndarray:
    """The image of sample `index`: H x W x 3 uint8."""
    return np.random.default_rng([seed, index]).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def _rigid(q, x, y, z):
    return common_pb2.RigidTransform(rotation=q, translation_m=common_pb2.Vector3(x=x, y=y, z=z))


def _inverse(q):
    return common_pb2.Quaternion(w=q.w, x=-q.x, y=-q.y, z=-q.z)


def _png(pixels: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def _fail(fault: Fault, context) -> None:
    if fault.hang:
        closed = threading.Event()
        context.add_callback(closed.set)
        closed.wait(30)
    elif fault.code is not None:
        status = status_pb2.Status(code=fault.code.value[0], message="made to fail")
        for detail in fault.details:
            packed = any_pb2.Any()
            packed.Pack(detail)
            status.details.append(packed)
        context.set_trailing_metadata((("grpc-status-details-bin", status.SerializeToString()),))
        context.abort(fault.code, "made to fail")


def retry_info(seconds: float) -> error_details_pb2.RetryInfo:
    return error_details_pb2.RetryInfo(retry_delay=duration_pb2.Duration(nanos=int(seconds * 1e9)))


if __name__ == "__main__":
    files = [open(path, "rb").read() for path in sys.argv[1:]]
    peer = Peer(grpc.ssl_server_credentials([tuple(files)]) if files else None)
    print(peer.port, flush=True)
    sys.stdin.read()
    peer.stop()
