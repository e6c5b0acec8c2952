"""The caller of a request: owner, scopes and limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jobs.records import LIMITS, SCOPES, KeyRecord, Limit, Scope
from jobs.settings import Settings

CALLER = "dynamictree.caller"
"""Key under which the authentication stores the caller in a request's scope."""


@dataclass(frozen=True, kw_only=True)
class Caller:
    """The caller of a request. Without an owner, the service requires no key and the caller sees everything."""

    owner: str | None = None
    key_id: str = ""
    scopes: tuple[Scope, ...] = SCOPES
    by_link: bool = False  # authenticated by a signed link, not by the key itself
    limits: Mapping[Limit, int] = field(default_factory=dict)  # empty if no key is required


ANYONE = Caller()


def caller_of(key: KeyRecord, settings: Settings) -> Caller:
    """Return the caller of a key; limits of the key override those of the settings."""
    limits: dict[Limit, int] = {name: getattr(settings, f"limit_{name}") for name in LIMITS}
    return Caller(owner=key.owner, key_id=key.id, scopes=key.scopes, limits=limits | dict(key.limits))
