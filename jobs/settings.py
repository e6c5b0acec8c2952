"""Settings of a process, read once from the environment (`DYNAMICTREE_…`). See docs/settings.md."""

import os
from hashlib import sha256
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated, Literal, Self

from pydantic import Field, SecretStr, ValidationError, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from pydantic_settings import SettingsError as NoJSON

from jobs.errors import SettingsError
from jobs.states import AUTO, CPU, GPU

MIB = 1024**2
GIB = 1024**3
DAY_S = 86400.0

RETRY_S = (0.0, 5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 50400.0, 72000.0, 86400.0)
"""Pauses between delivery attempts of a webhook [s]: the schedule that Standard Webhooks proposes."""

SOCKET_PATH_LIMIT = 100
"""Limit of a unix socket's path [bytes]; Linux allows 107."""


class Settings(BaseSettings):
    """Settings of one process. An unset URL means the embedded default in the state folder."""

    model_config = SettingsConfigDict(env_prefix="DYNAMICTREE_", frozen=True, extra="forbid", env_ignore_empty=True)

    state_dir: Path = Path("state")
    database_url: str | None = None
    redis_url: str | None = None
    artifacts_url: str | None = None
    s3_access_key_id: str | None = None
    s3_secret_access_key: SecretStr | None = None

    queue: str = Field(default="auto", pattern=r"^[a-z][a-z0-9-]{0,25}$")
    lease_s: float = Field(default=60.0, gt=0)
    heartbeat_s: float = Field(default=10.0, gt=0)
    max_lost_attempts: int = Field(default=2, ge=0, le=20)
    visibility_timeout_s: int = Field(default=7200, ge=1)
    restore_interval_s: int = Field(default=10, ge=1)
    soft_time_limit_s: int = Field(default=3300, ge=1)
    time_limit_s: int = Field(default=3600, ge=1)
    worker_threads: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1)
    worker_tasks_per_child: int = Field(default=50, ge=1)
    worker_memory_kib: int = Field(default=8_000_000, ge=100_000)
    job_memory_bytes: int | None = Field(default=None, ge=512 * MIB)
    progress_interval_s: float = Field(default=0.5, ge=0)
    patience_s: float = Field(default=600.0, ge=0)
    worker_alive_file: Path | None = None
    shutdown_grace_s: float = Field(default=20.0, ge=0)

    housekeeper_lease_s: float = Field(default=10.0, gt=0)
    outbox_interval_s: float = Field(default=0.1, gt=0)
    reaper_interval_s: float = Field(default=1.0, gt=0)
    resend_s: float = Field(default=60.0, gt=0)
    retention_interval_s: float = Field(default=60.0, gt=0)
    artifact_retention_s: float = Field(default=7 * DAY_S, gt=0)
    asset_retention_s: float = Field(default=30 * DAY_S, gt=0)
    job_retention_s: float = Field(default=30 * DAY_S, gt=0)

    max_json_bytes: int = Field(default=1 * MIB, ge=1024)
    max_interact_bytes: int = Field(default=256 * 1024, ge=1024)
    max_multipart_bytes: int = Field(default=1 * GIB, ge=1024)
    max_queued_jobs: int = Field(default=1000, ge=1)
    max_parsers: int = Field(default=2, ge=1)
    min_free_bytes: int = Field(default=1 * GIB, ge=0)
    state_size_bytes: int | None = Field(default=None, ge=1)
    upload_idle_s: float = Field(default=60.0, gt=0)
    parser_memory_bytes: int = Field(default=8 * GIB, ge=256 * MIB)
    parser_cpu_s: int = Field(default=120, ge=1)
    spectrum_cache_bytes: int = Field(default=256 * MIB, ge=0)
    max_upload_bytes: int = Field(default=4 * GIB, ge=1024)
    presigned_links: bool = False
    destinations: tuple[str, ...] = ()
    upload_begin_s: float = Field(default=600.0, gt=0)
    upload_retention_s: float = Field(default=DAY_S, gt=0)
    max_fetches: int = Field(default=8, ge=1)
    fetch_time_s: float = Field(default=600.0, gt=0)
    outbound_hosts: tuple[str, ...] = ()
    webhook_timeout_s: float = Field(default=15.0, gt=0)
    webhook_retry_s: tuple[float, ...] = Field(default=RETRY_S, min_length=1, max_length=20)
    webhook_retention_s: float = Field(default=30 * DAY_S, gt=0)
    keys: Literal["loopback", "required", "none"] = "loopback"
    limit_active_jobs: int = Field(default=25, ge=1)
    limit_bytes: int = Field(default=50 * 10**9, ge=1)
    limit_creates_per_min: int = Field(default=60, ge=1)
    limit_reads_per_min: int = Field(default=600, ge=1)
    limit_chunks_per_min: int = Field(default=6000, ge=1)
    limit_interact_per_s: int = Field(default=20, ge=1)
    limit_streams: int = Field(default=8, ge=1)
    max_streams: int = Field(default=256, ge=1)
    max_connections_per_address: int = Field(default=256, ge=1)
    hosts: tuple[str, ...] = ()
    cors_origins: tuple[str, ...] = ()
    embed_origins: tuple[Annotated[str, Field(pattern=r"^(\*|https?://[A-Za-z0-9.*:\[\]-]+)$")], ...] = ()
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"
    log_format: Literal["text", "json"] = "text"
    ops_address: str | None = Field(default=None, pattern=r"^\S+:\d{1,5}$")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.heartbeat_s * 2 > self.lease_s:
            raise ValueError(
                f"heartbeat_s is {self.heartbeat_s:g}; at most half of lease_s ({self.lease_s:g}) is allowed"
            )
        if self.soft_time_limit_s > self.time_limit_s:
            raise ValueError(
                f"soft_time_limit_s is {self.soft_time_limit_s}; at most time_limit_s ({self.time_limit_s}) is allowed"
            )
        scheme = self.resolved_database_url.partition(":")[0]  # without the URL's password
        if scheme not in ("sqlite", "postgresql", "postgresql+psycopg"):
            raise ValueError(f"database_url begins with {scheme!r}; sqlite or postgresql is allowed")
        if "://" not in self.resolved_artifacts_url:
            raise ValueError(f"artifacts_url is {self.artifacts_url!r}; file:///folder or s3://bucket is allowed")
        if self.destinations and self.resolved_artifacts_url.startswith("file:"):
            raise ValueError("destinations go with an artifacts_url in object storage; it is a folder")
        return self

    def share_of(self, total: int) -> int:
        """Return the slots of `total` that one owner may use at once: a quarter, at least one; all without keys."""
        return max(1, total // 4) if self.keys == "required" else total

    @property
    def worker_queue(self) -> str:
        """Return the queue that a worker with these settings serves."""
        return CPU if self.queue == AUTO else self.queue

    @property
    def job_queues(self) -> tuple[str, ...]:
        """Return the queues that jobs may be put into."""
        return (CPU, GPU) if self.queue == AUTO else (self.queue,)

    @property
    def resolved_database_url(self) -> str:
        """Return the job store's URL for SQLAlchemy."""
        return self.database_url or f"sqlite:///{self.state_dir.resolve() / 'jobs.sqlite'}"

    @property
    def redis_socket(self) -> Path:
        """Return the path of the embedded Redis's socket, in a temporary folder if that of the state is too long."""
        path = self.state_dir.resolve() / "redis" / "redis.sock"
        if len(os.fsencode(path)) <= SOCKET_PATH_LIMIT:
            return path
        return Path(gettempdir()) / f"dynamictree-{sha256(os.fsencode(path)).hexdigest()[:16]}.sock"

    @property
    def resolved_redis_url(self) -> str:
        """Return the broker's URL for redis-py."""
        return self.redis_url or f"unix://{self.redis_socket}?db=0"

    @property
    def broker_url(self) -> str:
        """Return the broker's URL for Celery, whose scheme for a unix socket differs from redis-py's."""
        url = self.resolved_redis_url
        if url.startswith("unix://"):
            return url.replace("unix://", "redis+socket://", 1).replace("?db=", "?virtual_host=")
        return url

    @property
    def resolved_artifacts_url(self) -> str:
        """Return the URL of the folder or bucket of artifacts."""
        return self.artifacts_url or (self.state_dir.resolve() / "artifacts").as_uri()

    @property
    def s3_credentials(self) -> dict[str, str]:
        """Return the key and secret of object storage if they are set; otherwise obstore reads AWS's variables."""
        if self.s3_access_key_id is None or self.s3_secret_access_key is None:
            return {}
        secret = self.s3_secret_access_key.get_secret_value()
        return {"access_key_id": self.s3_access_key_id, "secret_access_key": secret}

    @property
    def scratch_dir(self) -> Path:
        """Return the folder for unfinished files; at its start `serve` deletes all but half-done reconstructions."""
        return self.state_dir.resolve() / "scratch"


def read_settings(**overrides: object) -> Settings:
    """Read the environment, and the files in the folder DYNAMICTREE_SECRETS_DIR (one file per setting).

    Raises:
        SettingsError: a value is not allowed.
    """
    secrets = os.environ.get("DYNAMICTREE_SECRETS_DIR")
    try:
        return Settings(_secrets_dir=secrets, **overrides)  # type: ignore[arg-type]
    except NoJSON as error:
        raise SettingsError(f'{error}: not JSON, as \'["a", "b"]\' is; see docs/settings.md') from error
    except ValidationError as error:
        problems = "; ".join(
            f"DYNAMICTREE_{'_'.join(map(str, e['loc'])).upper()} is {e['input']!r}: {e['msg']}"
            if e["loc"]
            else e["msg"].removeprefix("Value error, ")
            for e in error.errors()
        )
        raise SettingsError(f"{problems}; see docs/settings.md") from error


def unknown_variables() -> list[str]:
    """Return environment variables with our prefix that are not settings, most likely typos."""
    names = {*(name.upper() for name in Settings.model_fields), "SECRETS_DIR", "MODELS", "SAMPLES", "URL", "API_KEY"}
    ours = (name.removeprefix("DYNAMICTREE_") for name in os.environ if name.startswith("DYNAMICTREE_"))
    return sorted(f"DYNAMICTREE_{name}" for name in ours if name not in names)
