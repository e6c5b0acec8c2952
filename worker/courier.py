"""Deliver webhooks in a thread of the housekeeper. A lease prevents duplicate deliveries."""

import asyncio
import logging
import threading
import time
from collections import Counter
from datetime import UTC, datetime

import sqlalchemy as sa
from standardwebhooks import Webhook

from jobs.clients.outbound import Outbound
from jobs.clients.webhooks import claim_due, record_attempt
from jobs.errors import OutboundError
from jobs.records import Delivery, Endpoint, Try
from jobs.settings import Settings
from jobs.store import Store

logger = logging.getLogger(__name__)

POLL_S = 0.5
MAX_CONCURRENT = 32
PER_OWNER = 4
"""Attempts per owner at once, so that an owner with slow receivers does not delay others."""

LEASE_MARGIN_S = 15.0
MAX_ANSWER_BYTES = 64 * 1024
MAX_DETAIL = 200


class Courier:
    """Finds due deliveries and makes one attempt at each."""

    def __init__(self, store: Store, settings: Settings, *, outbound: Outbound | None = None) -> None:
        self.store = store
        self.settings = settings
        self.outbound = outbound or Outbound(private_hosts=settings.outbound_hosts)
        self.looked_at = time.monotonic()  # lets the housekeeper detect that this thread hangs
        self.running: dict[asyncio.Task[None], str] = {}  # owner of each running attempt

    def run(self, stopped: threading.Event) -> None:
        """Deliver until stopped."""
        asyncio.run(self._run(stopped))

    async def _run(self, stopped: threading.Event) -> None:
        try:
            while not stopped.is_set():
                try:
                    await self.start_due()
                except (sa.exc.SQLAlchemyError, OSError) as error:
                    logger.warning("webhooks wait: %s: %s", type(error).__name__, error)
                self.looked_at = time.monotonic()
                await asyncio.sleep(POLL_S)
        finally:
            await asyncio.gather(*self.running, return_exceptions=True)

    async def start_due(self) -> int:
        """Start an attempt at every due delivery while places are free; return their number."""
        lease_s = self.settings.webhook_timeout_s + LEASE_MARGIN_S
        busy = Counter(self.running.values())
        room = MAX_CONCURRENT - len(self.running)
        due = await asyncio.to_thread(
            claim_due, self.store, lease_s=lease_s, limit=room, per_owner=PER_OWNER, busy=busy
        )
        for delivery, endpoint in due:
            task = asyncio.create_task(self._tell(delivery, endpoint))
            self.running[task] = endpoint.owner
            task.add_done_callback(self.running.pop)
        return len(due)

    async def _tell(self, delivery: Delivery, endpoint: Endpoint) -> None:
        at, began = self.store.clock(), time.monotonic()
        try:
            async with asyncio.timeout(self.settings.webhook_timeout_s):
                status, detail = await self._post(delivery, endpoint, datetime.fromtimestamp(round(at), UTC))
        except OutboundError as error:
            status, detail = None, str(error)
        except TimeoutError:
            status, detail = None, f"no answer within {self.settings.webhook_timeout_s:g} s"
        attempt = Try(at=at, status=status, detail=detail[:MAX_DETAIL], seconds=round(time.monotonic() - began, 3))
        state = await asyncio.to_thread(
            record_attempt, self.store, delivery, attempt, retry_s=self.settings.webhook_retry_s
        )
        logger.info("webhook %s of job %s: %s", delivery.event, delivery.job_id, state, extra={"status": status})

    async def _post(self, delivery: Delivery, endpoint: Endpoint, signed_at: datetime) -> tuple[int, str]:
        target = await self.outbound.check(endpoint.url)
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "dynamictree-webhooks",
            "webhook-id": delivery.message_id,
            "webhook-timestamp": str(round(signed_at.timestamp())),
            "webhook-signature": Webhook(endpoint.secret).sign(delivery.message_id, signed_at, delivery.payload),
        }
        content = delivery.payload.encode()
        async with self.outbound.send(target, "POST", headers=headers, content=content) as response:
            size = 0
            async for chunk in response.aiter_raw():
                size += len(chunk)
                if size > MAX_ANSWER_BYTES:
                    break
            redirected = "; redirects are not followed" if response.is_redirect else ""
            return response.status_code, f"answered {response.status_code}{redirected}"
