"""Slots that owners share."""

import asyncio

from service.http.slots import FairSlots


def test_an_owner_with_many_requests_delays_another_by_one_slot() -> None:
    order: list[str] = []

    async def work(slots: FairSlots, owner: str) -> None:
        async with slots.slot(owner):
            order.append(owner)
            await asyncio.sleep(0.001)

    async def main() -> None:
        slots = FairSlots(2, per_owner=2)
        many = [asyncio.create_task(work(slots, "many")) for _ in range(20)]
        await asyncio.sleep(0)
        await asyncio.gather(work(slots, "one"), *many)

    asyncio.run(main())
    assert order.index("one") == 2
    assert len(order) == 21


def test_an_owner_holds_at_most_its_share_and_a_place_given_up_is_free_again() -> None:
    async def main() -> None:
        slots = FairSlots(2, per_owner=1)
        async with slots.slot("a"):
            waiting = asyncio.create_task(slots.slot("a").__aenter__())
            await asyncio.sleep(0)
            assert not waiting.done()
            async with asyncio.timeout(1), slots.slot("b"):
                pass
            waiting.cancel()
            await asyncio.gather(waiting, return_exceptions=True)
        async with asyncio.timeout(1), slots.slot("a"), slots.slot("b"):
            pass

    asyncio.run(main())


def test_a_slot_that_was_granted_to_whom_is_cancelled_is_free_again() -> None:
    async def main() -> None:
        slots = FairSlots(1, per_owner=1)
        holder = slots.slot("a")
        await holder.__aenter__()
        waiting = asyncio.create_task(slots.slot("b").__aenter__())
        await asyncio.sleep(0)
        await holder.__aexit__(None, None, None)  # grants it to b, who has not gone on yet
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
        async with asyncio.timeout(1), slots.slot("c"):
            pass

    asyncio.run(main())
