"""Typed client of DynamicTree Service.

with Client("http://127.0.0.1:8000") as client:
    job = client.wait(client.animate("tree.glb"))
    client.download_all(job, "out")
"""

from dynamictree_client import models, operations
from dynamictree_client.asynchronous import AsyncClient
from dynamictree_client.errors import (
    AccessError,
    ClientError,
    ConflictError,
    GoneError,
    IntegrityError,
    InvalidRequestError,
    JobEndedError,
    NotFoundError,
    ProblemError,
    ServiceFaultError,
    TooBusyError,
    UnreachableError,
    WaitTimeoutError,
)
from dynamictree_client.retries import Retries
from dynamictree_client.synchronous import Client

__all__ = [
    "AccessError",
    "AsyncClient",
    "Client",
    "ClientError",
    "ConflictError",
    "GoneError",
    "IntegrityError",
    "InvalidRequestError",
    "JobEndedError",
    "NotFoundError",
    "ProblemError",
    "Retries",
    "ServiceFaultError",
    "TooBusyError",
    "UnreachableError",
    "WaitTimeoutError",
    "models",
    "operations",
]
