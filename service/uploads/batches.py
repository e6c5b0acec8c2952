"""Write a received body in batches, in threads, while the next batch is being received."""

import asyncio
from collections.abc import AsyncIterator, Callable

BATCH_BYTES = 4 * 1024**2
"""Size of the batch that a thread writes; at most two batches are in memory."""


async def write_in_batches(body: AsyncIterator[bytes], write: Callable[[list[bytes]], object]) -> int:
    """Pass a body to `write` and return its size [bytes]. If the body breaks off, what was received is written."""
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
