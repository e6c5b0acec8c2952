"""`dynamictree remote`: use a remote service from the command line."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

from dynamictree_client import operations
from dynamictree_client.errors import ClientError
from dynamictree_client.models import AnimateParams, Job, Model, Wind
from dynamictree_client.synchronous import Client

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Let a service do it: upload, wait, download.")

Url = Annotated[str, typer.Option(envvar="DYNAMICTREE_URL", help="Address of the service.")]
Key = Annotated[str | None, typer.Option(envvar="DYNAMICTREE_API_KEY", help="Key, where the service asks for one.")]
JobId = Annotated[str, typer.Argument(help="Id of a job.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the files; made if it is not there.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
LOCAL = "http://127.0.0.1:8000"


@app.command()
def animate(
    sources: Annotated[list[Path], typer.Argument(help="A mesh and what it names, photos, or a folder of them.")],
    output: Output,
    formats: Annotated[str, typer.Option("--format", help="Comma-separated, see GET /v1/limits.")] = "ply,glb,png",
    frames: Annotated[int | None, typer.Option(min=1, help="Frames to write; one period if not given.")] = None,
    fps: Annotated[float, typer.Option(min=1, max=240, help="Frames a second; never changes the speed.")] = 24.0,
    speed: Annotated[float, typer.Option(min=0.01, max=100, help="Times the natural speed.")] = 1.0,
    loop: Annotated[bool, typer.Option(help="Whole periods only, so that the last frame leads to the first.")] = True,
    num_steps: Annotated[int | None, typer.Option(min=1, max=1000, help="Sampler steps; the preset's own.")] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**53 - 1, help="The same seed gives the same motion.")] = 0,
    preset: Annotated[str, typer.Option(help="The model that generates the motion.")] = "small",
    wind_speed: Annotated[float, typer.Option(min=0, max=30, help="Mean wind speed \\[m/s].")] = 5.0,
    wind_direction: Annotated[
        float, typer.Option(min=-360, max=360, help="Where it blows to \\[° from +X to +Y].")
    ] = 0.0,
    gust: Annotated[float, typer.Option(min=0, max=2, help="Standard deviation of the speed over its mean.")] = 0.3,
    url: Url = LOCAL,
    api_key: Key = None,
    as_json: AsJson = False,
) -> None:
    """Make a tree sway, and fetch the files."""
    with _service(url, api_key) as client:
        params = AnimateParams.model_validate(
            {
                "wind": Wind(speed_m_s=wind_speed, direction_deg=wind_direction, gust=gust),
                "num_steps": num_steps,
                "num_frames": frames,
                "fps": fps,
                "speed": speed,
                "loop": loop,
                "formats": [name.strip() for name in formats.split(",")],
            }
        )
        asset = client.upload(sources)
        job = _followed(client, client.animate(asset, params, seed=seed, preset=preset), quiet=as_json)
        paths = client.download_all(job, output)
    _tell({"job": job.id, "files": [str(path) for path in paths.values()]}, as_json=as_json)


@app.command()
def jobs(
    limit: Annotated[int, typer.Option(min=1, max=100, help="At most so many.")] = 20,
    url: Url = LOCAL,
    api_key: Key = None,
    as_json: AsJson = False,
) -> None:
    """List jobs, newest first."""
    with _service(url, api_key) as client:
        listed = client.send(operations.list_jobs(limit=limit)).data
    if as_json:
        print(json.dumps([job.model_dump(mode="json") for job in listed]))
        return
    for job in listed:
        print(f"{job.id}  {job.type:<11} {job.state:<9} {job.progress:4.0%}  {job.created_at:%Y-%m-%d %H:%M}")


@app.command()
def show(job_id: JobId, url: Url = LOCAL, api_key: Key = None) -> None:
    """Print a job as JSON."""
    with _service(url, api_key) as client:
        _print(client.send(operations.get_job(job_id)))


@app.command()
def wait(job_id: JobId, url: Url = LOCAL, api_key: Key = None) -> None:
    """Wait for a job to end; exit status 2 if it does not succeed."""
    with _service(url, api_key) as client:
        _print(_followed(client, job_id, quiet=False))


@app.command()
def cancel(job_id: JobId, url: Url = LOCAL, api_key: Key = None) -> None:
    """Stop a job."""
    with _service(url, api_key) as client:
        _print(client.send(operations.cancel_job(job_id)))


@app.command()
def delete(job_id: JobId, url: Url = LOCAL, api_key: Key = None) -> None:
    """Delete a job that has ended, and its files."""
    with _service(url, api_key) as client:
        client.send(operations.delete_job(job_id))


@app.command()
def get(
    job_id: JobId,
    output: Output,
    names: Annotated[list[str] | None, typer.Option("--name", help="Only files of this name; may come again.")] = None,
    url: Url = LOCAL,
    api_key: Key = None,
    as_json: AsJson = False,
) -> None:
    """Download a job's files; what is there in part goes on, and hashes are checked."""
    with _service(url, api_key) as client:
        paths = client.download_all(job_id, output, names=names)
    _tell({"files": [str(path) for path in paths.values()]}, as_json=as_json)


@app.command()
def limits(url: Url = LOCAL, api_key: Key = None) -> None:
    """Print what the service takes, as JSON."""
    with _service(url, api_key) as client:
        _print(client.send(operations.get_limits()))


@contextmanager
def _service(url: str, api_key: str | None) -> Iterator[Client]:
    """Open a client; an error is printed on one line, with exit status 2."""
    try:
        with Client(url, api_key=api_key) as client:
            yield client
    except ClientError as error:
        _give_up(str(error))
    except ValidationError as error:
        first = error.errors()[0]
        _give_up(f"{'.'.join(map(str, first['loc']))}: {first['msg']}")


def _give_up(why: str) -> NoReturn:
    print(f"dynamictree: {why}", file=sys.stderr)
    raise typer.Exit(2) from None


def _followed(client: Client, job: Job | str, *, quiet: bool) -> Job:
    """Wait for a job, with one progress bar per stage on standard error."""
    columns = (TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as progress:
        bars: dict[str, TaskID] = {}

        def show_stages(now: Job) -> None:
            for stage in now.stages:
                if stage.name not in bars:
                    bars[stage.name] = progress.add_task(stage.name, total=1.0)
                progress.update(bars[stage.name], completed=stage.progress)

        return client.wait(job, on_progress=show_stages)


def _print(answer: Model) -> None:
    print(answer.model_dump_json(indent=2))


def _tell(facts: dict[str, str | list[str]], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(facts))
        return
    for name, value in facts.items():
        print(f"{name}: {', '.join(value) if isinstance(value, list) else value}")
