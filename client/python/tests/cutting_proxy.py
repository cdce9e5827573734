"""A TCP forwarder that breaks connections, so that resuming is tested against any server as a network failure."""

from __future__ import annotations

import socket
import threading


class CuttingProxy:
    """Forwards to `target` and resets each of the first `cuts` connections after `after_bytes` from the server."""

    def __init__(self, target: str, cuts: int, after_bytes: int):
        host, port = target.rsplit(":", 1)
        self._upstream = (host, int(port))
        self._cuts, self._after_bytes = cuts, after_bytes
        self.made = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.target = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        self._listener.close()

    def _accept(self):
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            limit = self._after_bytes if self.made < self._cuts else None
            self.made += 1
            threading.Thread(target=self._serve, args=(near, limit), daemon=True).start()

    def _serve(self, near, limit):
        with near, socket.create_connection(self._upstream) as far:
            requests = threading.Thread(target=_forward, args=(near, far, None), daemon=True)
            requests.start()
            _forward(far, near, limit)
            requests.join()


def _forward(source, sink, limit):
    passed = 0
    try:
        while chunk := source.recv(4096):
            if limit is not None and passed + len(chunk) > limit:
                sink.sendall(chunk[: limit - passed])
                break
            sink.sendall(chunk)
            passed += len(chunk)
    except OSError:
        pass
    for end in (source, sink):
        try:
            end.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
