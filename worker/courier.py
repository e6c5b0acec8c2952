"""Tells webhooks what they asked for: a thread of the housekeeper. A lease keeps two from telling the same."""

import asyncio
import logging
import threading
import time
from datetime import UTC, datetime

import sqlalchemy as sa
from standardwebhooks import Webhook

from jobs.errors import OutboundError
from jobs.outbound import Outbound
from jobs.settings import Settings
from jobs.store import Store
from jobs.webhooks import Delivery, Endpoint, Try, claim_due, record_try

logger = logging.getLogger(__name__)

LOOK_S = 0.5
AT_ONCE = 8
LEASE_MARGIN_S = 15.0
MAX_ANSWER_BYTES = 64 * 1024
MAX_DETAIL = 200


class Courier:
    """Looks for deliveries whose time has come, and makes one attempt at each."""

    def __init__(self, store: Store, settings: Settings, *, outbound: Outbound | None = None) -> None:
        self.store = store
        self.settings = settings
        self.outbound = outbound or Outbound(private_hosts=settings.outbound_hosts)

    def run(self, stopped: threading.Event) -> None:
        """Until stopped; a database that is away is waited for."""
        while not stopped.wait(LOOK_S):
            try:
                self.round()
            except (sa.exc.SQLAlchemyError, OSError) as error:
                logger.warning("webhooks wait: %s: %s", type(error).__name__, error)

    def round(self) -> int:
        """One attempt at everything that is due; gives the number of attempts."""
        lease_s = self.settings.webhook_timeout_s + LEASE_MARGIN_S
        due = claim_due(self.store, lease_s=lease_s, limit=AT_ONCE)
        if due:
            asyncio.run(self._tell_all(due))
        return len(due)

    async def _tell_all(self, due: list[tuple[Delivery, Endpoint]]) -> None:
        await asyncio.gather(*(self._tell(delivery, endpoint) for delivery, endpoint in due))

    async def _tell(self, delivery: Delivery, endpoint: Endpoint) -> None:
        at, began = self.store.clock(), time.monotonic()
        try:
            async with asyncio.timeout(self.settings.webhook_timeout_s):
                status, detail = await self._post(delivery, endpoint, datetime.fromtimestamp(round(at), UTC))
        except OutboundError as error:
            status, detail = None, str(error)
        except TimeoutError:
            status, detail = None, f"no answer within {self.settings.webhook_timeout_s:g} s"
        made = Try(at=at, status=status, detail=detail[:MAX_DETAIL], seconds=round(time.monotonic() - began, 3))
        state = await asyncio.to_thread(record_try, self.store, delivery, made, retry_s=self.settings.webhook_retry_s)
        logger.info("webhook %s of job %s: %s", delivery.event, delivery.job_id, state, extra={"status": status})

    async def _post(self, delivery: Delivery, endpoint: Endpoint, signed_at: datetime) -> tuple[int, str]:
        target = await self.outbound.check(endpoint.url)
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "dynamictree-webhooks",
            "webhook-id": delivery.message_id,
            "webhook-timestamp": str(round(signed_at.timestamp())),
            "webhook-signature": " ".join(
                Webhook(secret).sign(delivery.message_id, signed_at, delivery.payload)
                for secret in endpoint.signing_secrets(self.store.clock())
            ),
        }
        if delivery.traceparent:
            headers["traceparent"] = delivery.traceparent
        content = delivery.payload.encode()
        async with self.outbound.send(target, "POST", headers=headers, content=content) as response:
            size = 0
            async for chunk in response.aiter_raw():
                size += len(chunk)
                if size > MAX_ANSWER_BYTES:
                    break
            redirected = "; redirects are not followed" if response.is_redirect else ""
            return response.status_code, f"answered {response.status_code}{redirected}"
