"""Serve /metrics, /ops and the probes at a separate address without keys, if `ops_address` is set."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from fastapi import FastAPI

from service.http import problem_handlers
from service.routes import health, metrics, ops

ROUTES = (metrics, ops)
"""Routes that the application itself serves if `ops_address` is not set."""


@contextmanager
def serve_operations(app: FastAPI) -> Iterator[None]:
    """Context manager that serves these routes in a thread, since the application's event loop may be busy.

    Raises:
        OSError: the address is in use or not available.
    """
    address = app.state.settings.ops_address
    if address is None:
        yield
        return
    host, _, port = address.rpartition(":")
    own = FastAPI(openapi_url=None)
    own.state = app.state
    for resource in (*ROUTES, health):
        own.include_router(resource.router)
    problem_handlers.install(own)
    config = uvicorn.Config(own, log_config=None, access_log=False, lifespan="off", timeout_graceful_shutdown=2)
    server = uvicorn.Server(config)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host.strip("[]"), int(port)), family=family) as listening:
        thread = threading.Thread(target=server.run, args=([listening],), name="operations", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.should_exit = True
            thread.join()
