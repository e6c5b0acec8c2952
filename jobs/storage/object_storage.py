"""Object storage through obstore (S3, GCS, Azure, memory), with our timeouts and our exceptions."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from typing import Literal
from urllib.parse import urlsplit

import obstore
from obstore.exceptions import BaseError
from obstore.store import ObjectStore, from_url

from jobs.errors import StorageAwayError

REQUEST_PATIENCE_S = 5.0
LINK_S = 3600.0


def open_objects(
    url: str, *, patience_s: float = REQUEST_PATIENCE_S, credentials: Mapping[str, str] | None = None
) -> ObjectStore:
    """Open the storage of a URL, with any scheme of obstore (`s3://bucket/prefix`).

    If it is unavailable or returns 503, requests are retried for `patience_s`. `credentials` are those of S3, by
    obstore's names; without them it reads AWS's variables.
    """
    scheme = urlsplit(url).scheme
    if scheme == "memory":
        return from_url(url)
    return from_url(  # type: ignore[call-overload, no-any-return]
        url,
        **(credentials or {}) if scheme in ("s3", "s3a") else {},
        retry_config={
            "max_retries": int(10 + patience_s),
            "retry_timeout": timedelta(seconds=patience_s),
            "backoff": {"init_backoff": timedelta(seconds=0.1), "max_backoff": timedelta(seconds=2), "base": 2},
        },
    )


@contextmanager
def reporting_refusals() -> Iterator[None]:
    """Context manager that turns a refusal of the storage into StorageAwayError.

    Raises:
        StorageAwayError: the storage does not respond or refuses the request.
    """
    try:
        yield
    except BaseError as error:
        reason = str(error).partition("\n")[0][:300]
        raise StorageAwayError(f"the object storage does not do as it is asked: {reason}") from error


@reporting_refusals()
def presigned(objects: ObjectStore, method: Literal["GET", "PUT"], key: str) -> str:
    """Return a URL that allows a GET or PUT of one object for `LINK_S`; not every storage supports it."""
    return obstore.sign(objects, method, key, timedelta(seconds=LINK_S))  # type: ignore[arg-type]
