"""Wake requests that wait for a job to change; one query at a time serves all of them."""

import asyncio
import logging
from dataclasses import dataclass, field

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from jobs.store import Store

logger = logging.getLogger(__name__)

POLL_S = 0.2


@dataclass
class JobNotifier:
    """Waiting requests by job; one task polls the store while there are any."""

    store: Store
    _waiting: dict[str, dict[asyncio.Future[None], int]] = field(default_factory=dict)
    _looking: asyncio.Task[None] | None = None

    async def changed(self, job_id: str, version: int, timeout_s: float) -> bool:
        """Wait until a job has another version or is gone; return False if the time runs out first."""
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(job_id, {})[waiter] = version
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(timeout_s):
                await waiter
        except TimeoutError:
            return False
        finally:
            waiters = self._waiting.get(job_id, {})
            waiters.pop(waiter, None)
            if not waiters:
                self._waiting.pop(job_id, None)
        return True

    async def _look(self) -> None:
        while self._waiting:
            try:
                versions = await run_in_threadpool(self.store.job_versions, list(self._waiting))
            except sa.exc.SQLAlchemyError as error:
                logger.warning("changes cannot be looked for: %s", error)
            else:
                self._wake(versions)
            await asyncio.sleep(POLL_S)

    def _wake(self, versions: dict[str, int]) -> None:
        for job_id, waiters in self._waiting.items():
            for waiter, version in waiters.items():
                if versions.get(job_id) != version and not waiter.done():
                    waiter.set_result(None)
