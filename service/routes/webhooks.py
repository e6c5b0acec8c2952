"""/v1/webhook-endpoints: receivers of job events, signed as Standard Webhooks defines; see docs/webhooks.md."""

from typing import Annotated

from fastapi import APIRouter, FastAPI, Query, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from jobs.clients import webhooks
from jobs.records import ENDS, EVENTS, DeliveryState, Event
from jobs.states import JobState, JobType
from service.http.routing import Cursor, Id, headers, refusals
from service.schemas.base import Payload, Time
from service.services import OwnedDep

router = APIRouter(prefix="/v1/webhook-endpoints", tags=["webhooks"])


class EndpointRequest(Payload):
    """URL and events of an endpoint."""

    url: str = Field(max_length=2048, description="HTTPS address")
    events: tuple[Event, ...] = Field(
        default=ENDS, max_length=len(EVENTS), description="Events of all jobs; if empty, of jobs that name the endpoint"
    )


class EndpointPayload(Payload):
    """A receiver of events."""

    id: str
    url: str
    events: list[Event]
    disabled_reason: str | None
    created_at: Time


class EndpointWithSecretPayload(EndpointPayload):
    """An endpoint with its secret, which is returned only once."""

    secret: str = Field(description="Key of HMAC-SHA256 over id.timestamp.body, as whsec_ and base64")


class EndpointListPayload(Payload):
    """All endpoints."""

    data: list[EndpointPayload]


class TryPayload(Payload):
    """One delivery attempt."""

    at: Time
    status: int | None = Field(description="HTTP status; null without a response")
    detail: str
    seconds: float


class DeliveryPayload(Payload):
    """A message to one endpoint."""

    id: str
    message_id: str = Field(description="Header webhook-id, the same in every attempt")
    event: Event
    job_id: str
    state: DeliveryState
    tries: list[TryPayload]
    next_at: Time | None = Field(description="Time of the next attempt; null if there is none")
    created_at: Time


class JobEventData(Payload):
    """The job that an event is about."""

    id: str
    type: JobType
    state: JobState
    asset_id: str
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    error_code: str | None
    url: str = Field(description="Path of the job")


class JobEventPayload(Payload):
    """Body of a signed event."""

    type: Event
    timestamp: Time
    data: JobEventData


def describe_events(app: FastAPI) -> None:
    """Name every event in the OpenAPI document, with the body that is sent to endpoints."""
    for event in EVENTS:
        name = event.title().replace(".", "").replace("-", "")

        async def receive(body: JobEventPayload) -> None:
            """A job has its first artifact, or has ended. Answer with any status of 2xx; see docs/webhooks.md."""

        app.webhooks.add_api_route(
            event,
            receive,
            methods=["POST"],
            operation_id=f"on{name}",
            status_code=204,
            tags=["events"],
            responses={"default": {"description": "Any other status: the event is sent again later"}},
        )


class DeliveryListPayload(Payload):
    """A page of deliveries, newest first."""

    data: list[DeliveryPayload]
    next_cursor: str | None


@router.post(
    "",
    status_code=201,
    responses=refusals("conflict", "fetch-failed") | {201: {"description": "Created", **headers(Location="its URL")}},
)
async def create_webhook_endpoint(
    body: EndpointRequest, response: Response, owned: OwnedDep
) -> EndpointWithSecretPayload:
    """Register an address that receives an event when a job ends. The signing secret is returned only here."""
    await owned.services.outbound.check(body.url)
    new = await run_in_threadpool(webhooks.add_endpoint, owned.store, body.url, body.events)
    response.headers["Location"] = f"/v1/webhook-endpoints/{new.id}"
    return EndpointWithSecretPayload.of(new)


@router.get("", responses=refusals())
def list_webhook_endpoints(owned: OwnedDep) -> EndpointListPayload:
    """List all endpoints."""
    return EndpointListPayload(data=[EndpointPayload.of(endpoint) for endpoint in webhooks.endpoints(owned.store)])


@router.delete("/{id}", status_code=204, responses=refusals("not-found"))
def delete_webhook_endpoint(id: Id, owned: OwnedDep) -> None:
    """Delete an endpoint and its deliveries."""
    webhooks.delete_endpoint(owned.store, id)


@router.get("/{id}/deliveries", responses=refusals("not-found"))
def list_webhook_deliveries(
    id: Id,
    owned: OwnedDep,
    cursor: Cursor = None,
    limit: Annotated[int, Query(ge=1, le=100, description="Deliveries per page")] = 20,
) -> DeliveryListPayload:
    """List deliveries to an endpoint, newest first, with every attempt."""
    records = webhooks.deliveries(owned.store, id, before=cursor, limit=limit + 1)
    page = records[:limit]
    return DeliveryListPayload(
        data=[DeliveryPayload.of(delivery, tries=delivery.log) for delivery in page],
        next_cursor=page[-1].id if len(records) > limit else None,
    )
