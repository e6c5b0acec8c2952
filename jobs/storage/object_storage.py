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
    """The storage that a URL names, by any scheme of obstore (`s3://bucket/prefix`).

    One that is away, or answers 503, is asked again for `patience_s`. `credentials` are of S3, by obstore's names;
    without them it looks into AWS's own variables.
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
    """Report what a storage refuses as StorageAwayError.

    Raises:
        StorageAwayError: it does not answer, or not as it is asked.
    """
    try:
        yield
    except BaseError as error:
        reason = str(error).partition("\n")[0][:300]
        raise StorageAwayError(f"the object storage does not do as it is asked: {reason}") from error


@reporting_refusals()
def presigned(objects: ObjectStore, method: Literal["GET", "PUT"], key: str) -> str:
    """Address by which whoever has it may get or put one object, for `LINK_S`; not every storage has such."""
    return obstore.sign(objects, method, key, timedelta(seconds=LINK_S))  # type: ignore[arg-type]
