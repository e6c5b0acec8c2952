"""`Prefer: wait=N`: hold the answer back until something changes. RFC 7240."""

import re
from typing import Annotated

from fastapi import Depends, Header

MAX_WAIT_S = 30.0
LOOK_S = 0.25
_WAIT = re.compile(r"\bwait\s*=\s*\"?(\d{1,6})")


async def _preferred(
    prefer: Annotated[str | None, Header(description=f"wait=N waits up to N s, at most {MAX_WAIT_S:g}")] = None,
) -> float:
    match = _WAIT.search(prefer or "")
    return min(float(match.group(1)), MAX_WAIT_S) if match else 0.0


WaitS = Annotated[float, Depends(_preferred)]
"""How long the client would wait [s]."""
