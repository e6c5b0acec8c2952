"""How schemathesis sends the bytes of tus: as they are. Found by SCHEMATHESIS_HOOKS."""

import schemathesis


@schemathesis.serializer("application/offset+octet-stream")
def _as_they_are(_context: object, value: object) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode()
