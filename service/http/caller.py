"""The caller of a request: owner, scopes and limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jobs.records import LIMITS, SCOPES, KeyRecord, Limit, Scope
from jobs.settings import Settings

CALLER = "dynamictree.caller"
"""Where the doors leave the caller in a request's scope."""


@dataclass(frozen=True, kw_only=True)
class Caller:
    """The caller of a request. Without an owner, the service requires no key and the caller sees everything."""

    owner: str | None = None
    key_id: str = ""
    scopes: tuple[Scope, ...] = SCOPES
    by_link: bool = False  # a signed link, in place of the key that signed it
    limits: Mapping[Limit, int] = field(default_factory=dict)  # none where no key is asked for


ANYONE = Caller()


def caller_of(key: KeyRecord, settings: Settings) -> Caller:
    """Caller of a key; limits of the key override those of the settings."""
    limits: dict[Limit, int] = {name: getattr(settings, f"limit_{name}") for name in LIMITS}
    return Caller(owner=key.owner, key_id=key.id, scopes=key.scopes, limits=limits | dict(key.limits))
