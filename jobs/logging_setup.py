"""Logging: lines for people, or one JSON object per line for machines. Set up once per process."""

import json
import logging
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime

from jobs.settings import Settings

_IDS: ContextVar[Mapping[str, str | int]] = ContextVar("dynamictree_ids", default={})  # noqa: B039 (never changed)
_OWN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
TEXT = "%(asctime)s %(levelname)s %(name)s %(message)s"


@contextmanager
def log_ids(**ids: str | int | None) -> Iterator[None]:
    """Context manager that adds ids to every log line of this thread or task: request_id, job_id, attempt."""
    token = _IDS.set({**_IDS.get(), **{name: value for name, value in ids.items() if value is not None}})
    try:
        yield
    finally:
        _IDS.reset(token)


class JsonLines(logging.Formatter):
    """JSON formatter, one object per line: time, level, logger, message, ids, `extra`, and the traceback if any."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as one line."""
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **_IDS.get(),
            **{name: value for name, value in vars(record).items() if name not in _OWN},
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


_SIGNATURE = re.compile(r"(signature=)[^&\s\"]+")


def _without_signature(record: logging.LogRecord) -> bool:
    """Remove the signature from a line of the access log: anyone who reads a signed link can open its file."""
    if isinstance(record.args, tuple):
        record.args = tuple(_SIGNATURE.sub(r"\1…", each) if isinstance(each, str) else each for each in record.args)
    return True


def set_up_logging(settings: Settings) -> None:
    """Send every line of this process to stderr in the format of the settings: uvicorn's, Celery's and warnings too."""
    stream = logging.StreamHandler(sys.stderr)
    stream.setFormatter(JsonLines() if settings.log_format == "json" else logging.Formatter(TEXT))
    logging.basicConfig(level=settings.log_level, handlers=[stream], force=True)
    logging.captureWarnings(True)
    for name in ("uvicorn", "uvicorn.access"):
        own = logging.getLogger(name)
        if own.handlers:  # uvicorn's own; with --no-access-log, "uvicorn.access" has none and stays silent
            own.handlers.clear()
            own.propagate = True
    logging.getLogger("uvicorn.access").addFilter(_without_signature)
    logging.getLogger("httpx").setLevel("WARNING")  # httpx logs whole URLs, with secrets of webhooks and storages
