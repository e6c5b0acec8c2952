"""MCP server over the client, on standard input and output: `dynamictree-mcp --url URL --folder FOLDER`.

A language model uploads a tree, asks for its motion, waits, downloads and pushes. It reads and writes files below one
folder only. The key comes from DYNAMICTREE_API_KEY, never from the model. Needs the extra `mcp`.
"""

import argparse
import os
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Annotated, Literal

from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import BaseModel, Field

from dynamictree_client.asynchronous import AsyncClient
from dynamictree_client.errors import ClientError, WaitTimeoutError
from dynamictree_client.models import AnimateParams, AnimateRequest, At, Force, InteractRequest, Job, LinkRequest, Wind
from dynamictree_client.operations import cancel_job, create_link, get_job, list_jobs

MAX_WAIT_S = 600.0
INSTRUCTIONS = (
    "Makes captured or modelled trees sway. Order: upload, animate, wait_for_job (repeat while it runs), download. "
    "cancel stops a job, list_recent_jobs and download_link find jobs and files again. "
    "interact pushes a tree whose job has succeeded. Lengths are in metres, +Z is up."
)
Axes = tuple[float, float, float]


class UploadedTree(BaseModel):
    """An uploaded asset, as input of `animate`."""

    asset_id: str
    kind: str
    summary: dict[str, object]


class JobReport(BaseModel):
    """State of a job. `spectrum_id` is the input of `interact`, `files` that of `download`."""

    job_id: str
    state: str
    progress: float
    eta_s: float | None = None
    error: str | None = None
    spectrum_id: str | None = None
    files: list[str] = []


class Swing(BaseModel):
    """How a tree answers a push: the largest modal amplitude of each natural frequency."""

    frequencies_hz: list[float]
    largest_amplitude: list[float]
    damping_ratio: float
    mass_kg: float


def make_server(url: str, folder: Path, *, api_key: str | None = None) -> MCPServer:
    """Build the server for a service at an address; files are read and written below `folder`."""
    root = folder.resolve()

    @asynccontextmanager
    async def connected(_: MCPServer) -> AsyncIterator[None]:
        async with AsyncClient(url, api_key=api_key) as opened:
            clients.append(opened)
            try:
                yield
            finally:
                clients.remove(opened)

    clients: list[AsyncClient] = []
    server = MCPServer("dynamictree", instructions=INSTRUCTIONS, lifespan=connected)

    def below(name: str) -> Path:
        path = (root / name).resolve()
        if not path.is_relative_to(root):
            raise ToolError(f"{name} is outside of {root}, which is the only folder that is read and written")
        return path

    @server.tool()
    async def upload(
        paths: Annotated[list[str], Field(min_length=1, description="a mesh, splat, scan, or photos; relative")],
        up_axis: Annotated[str | None, Field(description="y or z; the format's own if unset")] = None,
        unit_m: Annotated[float | None, Field(description="length of the file's unit [m]")] = None,
    ) -> UploadedTree:
        """Send the files of one tree."""
        with _refusals():
            asset = await clients[-1].upload([below(path) for path in paths], up_axis=up_axis, unit_m=unit_m)
        return UploadedTree(asset_id=asset.id, kind=asset.kind, summary=dict(asset.summary))

    @server.tool()
    async def animate(
        asset_id: str,
        wind_m_s: Annotated[float, Field(ge=0, le=60, description="mean wind [m/s]")] = 5.0,
        seed: Annotated[int, Field(ge=0, description="another seed is another gust")] = 0,
        formats: Annotated[
            list[str] | None, Field(description="such as glb, usd, vat; the usual ones if unset")
        ] = None,
    ) -> JobReport:
        """Ask for the tree's motion; the answer is a job that has only begun."""
        params = AnimateParams(wind=Wind(speed_m_s=wind_m_s), formats=formats)
        request = AnimateRequest(type="animate", asset_id=asset_id, params=params, seed=seed)
        with _refusals():
            return await report(await clients[-1].create_job(request))

    @server.tool()
    async def wait_for_job(
        job_id: str, timeout_s: Annotated[float, Field(gt=0, le=MAX_WAIT_S, description="[s]")] = 60.0
    ) -> JobReport:
        """Wait until a job has ended, or for a while; call it again where the state is queued or running."""
        with _refusals():
            try:
                job = await clients[-1].wait(job_id, timeout_s=timeout_s)
            except WaitTimeoutError:
                job = await clients[-1].send(get_job(job_id))
            return await report(job)

    @server.tool()
    async def download(
        job_id: str,
        folder: Annotated[str, Field(description="relative; made where it is not there")],
        names: Annotated[list[str] | None, Field(description="of the job's files; all if unset")] = None,
    ) -> list[str]:
        """Fetch a job's files, each checked by its hash; gives their paths."""
        with _refusals():
            paths = await clients[-1].download_all(job_id, below(folder), names=names)
        return [str(path.relative_to(root)) for path in paths.values()]

    @server.tool()
    async def cancel(job_id: str) -> JobReport:
        """Stop a job that waits or runs."""
        with _refusals():
            return await report(await clients[-1].send(cancel_job(job_id)))

    @server.tool()
    async def list_recent_jobs(limit: Annotated[int, Field(ge=1, le=20)] = 10) -> list[JobReport]:
        """The last jobs, newest first."""
        with _refusals():
            page = await clients[-1].send(list_jobs(limit=limit))
            return [await report(job) for job in page.data]

    @server.tool()
    async def download_link(job_id: str, file: Annotated[str, Field(description="of the job's files")]) -> str:
        """An address of one file, which opens without a key for a while where the service asks for keys."""
        with _refusals():
            named = {artifact.name: artifact for artifact in await clients[-1].artifacts(job_id)}
            if file not in named:
                raise ToolError(f"the job has no file {file}; it has {', '.join(named) or 'none'}")
            link = await clients[-1].send(create_link(LinkRequest(path=named[file].url)))
        return url.rstrip("/") + link.url

    @server.tool()
    async def interact(
        spectrum_id: str,
        kind: Literal["impulse", "drag"] = "impulse",
        point_m: Annotated[Axes, Field(description="where, nearest place of the tree [m]")] = (0.0, 0.0, 1.0),
        vector: Annotated[Axes, Field(description="[N s] of an impulse, [N] of a drag")] = (10.0, 0.0, 0.0),
        seconds: Annotated[float, Field(gt=0, le=10)] = 2.0,
    ) -> Swing:
        """Push a tree and tell how it swings."""
        given = {"impulse_n_s": vector} if kind == "impulse" else {"force_n": vector}
        force = Force(kind=kind, at=At(point_m=point_m), **given)
        request = InteractRequest(spectrum_id=spectrum_id, forces=[force], num_frames=max(1, round(seconds * 60)))
        with _refusals():
            answer = await clients[-1].interact(request)
        q = [abs(complex(*value)) for group in answer.groups for frame in group.q for value in frame]
        width = len(answer.frequencies_hz)
        largest = [max(q[mode::width], default=0.0) for mode in range(width)]
        return Swing(
            frequencies_hz=answer.frequencies_hz,
            largest_amplitude=largest,
            damping_ratio=answer.damping_ratio,
            mass_kg=answer.mass_kg,
        )

    async def report(job: Job) -> JobReport:
        files = [artifact.name for artifact in await clients[-1].artifacts(job)] if job.state == "succeeded" else []
        return JobReport(
            job_id=job.id,
            state=job.state,
            progress=job.progress,
            eta_s=job.eta_s,
            error=None if job.error is None else job.error.detail,
            spectrum_id=None if job.result is None else job.result.spectrum_id,
            files=files,
        )

    return server


@contextmanager
def _refusals() -> Iterator[None]:
    """Context manager that turns errors of the client into tool errors, whose message the model reads."""
    try:
        yield
    except (ClientError, OSError) as error:
        raise ToolError(str(error)) from error


def main() -> None:
    """Serve on standard input and output until the other side ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default=os.environ.get("DYNAMICTREE_URL", "http://127.0.0.1:8000"))
    parser.add_argument("--folder", type=Path, default=Path(), help="the only folder that is read and written")
    given = parser.parse_args()
    make_server(given.url, given.folder, api_key=os.environ.get("DYNAMICTREE_API_KEY")).run()


if __name__ == "__main__":
    main()
