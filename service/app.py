"""Application factory: routes, middleware, and the services opened in the lifespan."""

import asyncio
import gc
import logging
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware

from jobs.logging_setup import set_up_logging
from jobs.settings import Settings, read_settings, unknown_variables
from jobs.storage.parser_process import reader_works
from service import operations
from service.http import problem_handlers
from service.http.authentication import Authentication
from service.http.middleware import BodyLimit, RequestFrame
from service.openapi.document import CONTACT, DESCRIPTION, LICENSE, SERVERS, described, operation_id
from service.routes import (
    artifacts,
    assets,
    catalogue,
    health,
    interact,
    interact_stream,
    job_events,
    jobs,
    links,
    pages,
    spectra,
    surface,
    uploads,
    webhooks,
)
from service.services import open_services
from service.uploads.ingest import Ingest

logger = logging.getLogger(__name__)

ROUTES = (
    *(uploads, assets, jobs, job_events, artifacts, links, spectra, interact, interact_stream),
    *(surface, pages, webhooks, catalogue, health),
)
"""Route modules, one per resource."""

EXPOSED = (
    *("ETag", "Location", "Link", "Retry-After", "RateLimit", "RateLimit-Policy", "X-Request-Id", "Content-Range"),
    *("Upload-Offset", "Upload-Length", "Upload-Expires", "Upload-Metadata"),
    *("Tus-Resumable", "Tus-Version", "Tus-Extension", "Tus-Max-Size"),
)
"""Headers that a page of an allowed origin may read."""

WARM_UP_AFTER_S = 3.0
"""Delay of the warm-up [s], so that worker and housekeeper can start first."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """Build the application; settings are read from the environment unless given."""
    settings = settings or read_settings()
    app = FastAPI(
        title="DynamicTree Service",
        version=version("dynamictree"),
        summary="Captured trees that move.",
        lifespan=_lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
        separate_input_output_schemas=False,
        generate_unique_id_function=operation_id,
        redirect_slashes=False,  # a redirect would send the key to the request's own Host, without TLS behind a proxy
        description=DESCRIPTION,
        servers=SERVERS,
        license_info=LICENSE,
        contact=CONTACT,
    )
    webhooks.describe_events(app)
    app.openapi = partial(described, app)  # type: ignore[method-assign]
    app.state.settings = settings
    for resource in (*ROUTES, *(operations.ROUTES if settings.ops_address is None else ())):
        app.include_router(resource.router)
    problem_handlers.install(app)
    app.add_middleware(BodyLimit, settings=settings)
    app.add_middleware(Authentication, settings=settings)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.cors_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=EXPOSED,
        )
    app.add_middleware(RequestFrame)
    return app


def serving_app() -> FastAPI:
    """Build the application for a server, and import slow modules in a thread after the start."""
    app = create_app()
    set_up_logging(app.state.settings)
    if unknown := unknown_variables():
        logger.warning("%s: no such setting; see docs/settings.md", ", ".join(unknown))
    warm_up = threading.Timer(WARM_UP_AFTER_S, _warm_up, (app.state.settings,))
    warm_up.daemon = True
    warm_up.start()
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[dict[str, object]]:
    with open_services(app.state.settings) as services:
        app.state.services = services
        with operations.serve_operations(app):
            ingest = asyncio.create_task(Ingest(services).run())
            yield {"max_connections_per_address": services.settings.max_connections_per_address}
            ingest.cancel()
            await asyncio.gather(ingest, return_exceptions=True)


def _warm_up(settings: Settings) -> None:
    reader_works(settings)  # starts the process that reads uploads, and logs if it fails
    # numba: the first push and the first request for the limits would otherwise wait for its import
    import dynamictree.export.table
    import dynamictree.gaussian.deform
    import dynamictree.modal.pull  # noqa: F401

    gc.freeze()  # modules are never garbage; scanning them again takes 50 ms, every second or two
