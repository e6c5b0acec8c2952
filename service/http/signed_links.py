"""Signed links, which open one path for a limited time without a key in a header.

A link holds the id of its key, its expiry time and an HMAC over both and the path; nothing is stored. It opens what
the key opens, so revoking the key ends all its links.
"""

import hmac
import re
from dataclasses import dataclass
from hashlib import sha256
from urllib.parse import parse_qs, urlencode

from jobs.records import KeyRecord
from service.schemas.base import ULID_PATTERN

_ID = ULID_PATTERN.strip("^$")
LINKABLE = re.compile(rf"/v1/(artifacts/{_ID}|spectra/{_ID}(/surface|/modes|/reach)?|assets/{_ID}/(surface|points))")
"""Paths of files that a viewer loads by URL."""

MAX_QUERY_BYTES = 2048
CONTEXT = "dynamictree signed link 1"


@dataclass(frozen=True, kw_only=True)
class LinkSignature:
    """Signature of a link in its query string."""

    key_id: str
    expires: int  # [s since 1970]
    signature: str

    @classmethod
    def of_query(cls, query: bytes) -> "LinkSignature | None":
        """Parse a query string; return None if it has no valid signature fields."""
        if len(query) > MAX_QUERY_BYTES or b"signature=" not in query:
            return None
        fields = parse_qs(query.decode("latin-1"), keep_blank_values=True)
        try:
            [key_id], [expires], [signature] = (fields.get(name, []) for name in ("key_id", "expires", "signature"))
        except ValueError:
            return None
        if not (expires.isascii() and expires.isdecimal() and len(expires) <= 12 and signature.isascii()):
            return None
        return cls(key_id=key_id, expires=int(expires), signature=signature)

    def opens(self, key: KeyRecord, path: str, now: float) -> bool:
        """Return whether the signature is valid for this key and path and has not expired."""
        return now < self.expires and hmac.compare_digest(self.signature, _signature(key, path, self.expires))


def signed(key: KeyRecord, path: str, expires: int) -> str:
    """Return the path with a signature that expires at a time [s since 1970]."""
    query = {"key_id": key.id, "expires": str(expires), "signature": _signature(key, path, expires)}
    return f"{path}?{urlencode(query)}"


def _signature(key: KeyRecord, path: str, expires: int) -> str:
    message = "\n".join((CONTEXT, key.id, str(expires), path))
    return hmac.new(key.digest.encode(), message.encode(), sha256).hexdigest()
