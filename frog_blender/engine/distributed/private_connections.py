"""Connections between the processes of a local cluster, which prove to each other that they know its key.

Dask's own are open to every user of the computer, who can run code by them. Its TLS needs certificates, and a package
that it does not bring makes them. Nobody but the computer's owner can listen to what passes between its processes.
"""

from __future__ import annotations

import asyncio
import hmac
import os
import secrets
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from distributed.comm import Comm
from distributed.comm.registry import backends
from distributed.comm.tcp import TCPBackend, TCPConnector, TCPListener
from tornado.iostream import IOStream, StreamClosedError

SCHEME = "frog"
KEY = "FROG_CLUSTER_KEY"
"""The variable of the environment that tells a worker the key."""
_BYTES = 32
_PATIENCE = 10.0  # seconds


async def _is_proven(stream: IOStream, key: bytes, *, listens: bool) -> bool:
    """Whether the other end of a connection knows the key; it is shown that this one does.

    The port is part of what is shown, so that nobody can pass on what another port was shown.
    """
    port = (stream.socket.getsockname if listens else stream.socket.getpeername)()[1]
    own = secrets.token_bytes(_BYTES)
    await stream.write(own)
    other = await stream.read_bytes(_BYTES)
    both = own + other if listens else other + own
    called, answered = (hmac.digest(key, f"{role} {port} ".encode() + both, "sha256") for role in ("call", "answer"))
    if not listens:
        await stream.write(called)
    is_right = hmac.compare_digest(await stream.read_bytes(_BYTES), called if listens else answered)
    if listens and is_right:
        await stream.write(answered)
    return is_right


async def _proven(stream: IOStream, key: bytes, *, listens: bool) -> IOStream | None:
    """The connection; None, and closed, where the other end does not know the key."""
    with suppress(StreamClosedError, asyncio.TimeoutError, OSError):
        if await asyncio.wait_for(_is_proven(stream, key, listens=listens), _PATIENCE):
            return stream
    stream.close()
    return None


class _Connector(TCPConnector):
    prefix = f"{SCHEME}://"

    def __init__(self, key: bytes) -> None:
        self._key = key

    async def connect(self, address: str, deserialize: bool = True, **more: Any) -> Comm:
        comm: Any = await TCPConnector.connect(self, address, deserialize, **more)
        if await _proven(comm.stream, self._key, listens=False) is None:
            comm.abort()
            raise OSError("another process than the cluster's has answered")
        return comm  # type: ignore[no-any-return]


class _Listener(TCPListener):
    prefix = f"{SCHEME}://"
    key = b""

    async def _prepare_stream(self, stream: IOStream, _address: str) -> IOStream | None:
        return await _proven(stream, self.key, listens=True)


class _Backend(TCPBackend):
    def __init__(self, key: bytes) -> None:
        self._key = key

    def get_connector(self) -> _Connector:
        return _Connector(self._key)

    def get_listener(self, loc: str, handle_comm: Callable[..., Any], deserialize: bool, **more: Any) -> _Listener:
        listener = _Listener(loc, handle_comm, deserialize, **more)  # type: ignore[no-untyped-call]  # of Dask
        listener.key = self._key
        return listener


def use(key: str) -> None:
    """Has this process connect by the scheme with a key."""
    backends[SCHEME] = _Backend(bytes.fromhex(key))


def dask_setup(server: Any) -> None:
    """Closes a worker's, or a scheduler's, pages for browsers, which ask nobody for a key. Dask calls it in workers."""
    server.http_server.stop()


if KEY in os.environ:  # Dask imports this module in each process of a local cluster
    use(os.environ[KEY])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # reaches all of a terminal's processes, and the command decides
