"""Write a body that comes over the network in batches, in threads, while the next one comes in."""

import asyncio
from collections.abc import AsyncIterator, Callable

BATCH_BYTES = 4 * 1024**2
"""So much is handed to a thread at once; two batches at most are in memory."""


async def write_in_batches(body: AsyncIterator[bytes], write: Callable[[list[bytes]], object]) -> int:
    """Hand a body to `write` and return its size [bytes]. Whatever ends the body, what came is written first."""
    loop = asyncio.get_running_loop()
    writing: asyncio.Future[object] | None = None
    batch: list[bytes] = []
    size = waiting = 0

    async def finish() -> None:
        if writing is not None:
            await writing
        if batch:
            await loop.run_in_executor(None, write, batch)

    try:
        async for chunk in body:
            batch.append(chunk)
            size, waiting = size + len(chunk), waiting + len(chunk)
            if waiting >= BATCH_BYTES:
                if writing is not None:
                    await asyncio.shield(writing)  # a thread cannot be cancelled; `finish` waits for it
                writing = loop.run_in_executor(None, write, batch)
                batch, waiting = [], 0
    finally:
        await asyncio.shield(finish())
    return size
