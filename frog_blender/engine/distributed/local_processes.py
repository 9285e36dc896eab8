"""What Dask imports in each process of a local cluster."""

import signal
from typing import Any

signal.signal(signal.SIGINT, signal.SIG_IGN)  # reaches all of a terminal's processes, and the command decides


def dask_setup(server: Any) -> None:
    """Closes the pages for browsers of a worker, which ask nobody for a certificate."""
    server.http_server.stop()
