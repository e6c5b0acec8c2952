"""`dynamictree study serve` and `dynamictree study results`: people compare films without knowing which is whose."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
import uvicorn

from service.local.command_line import one_line
from service.study.app import create_study
from service.study.films import StudyError, find_films
from service.study.results import preferences
from service.study.votes import FILE_NAME, Votes

app = typer.Typer(help="Blind comparison of films: serve the page, count the votes.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(help="films as FOLDER/METHOD/TREE.mp4; votes are stored beside them")]


@app.command()
def serve(
    folder: Folder,
    host: Annotated[str, typer.Option(help="address to listen at")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="port to listen at", min=1, max=65535)] = 8010,
) -> None:
    """Show pairs of films to people and store which they prefer, until stopped."""
    with one_line("study serve"):
        films = find_films(folder)
        votes = Votes(folder)
    typer.echo(f"study of {len(films.pairs())} pairs of films at http://{host}:{port}", err=True)
    uvicorn.run(create_study(films, votes), host=host, port=port, log_level="warning")


@app.command()
def results(folder: Folder, as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False) -> None:
    """Print how often each method was preferred, per question, with a 95 % interval."""
    with one_line("study results"):
        if not (folder / FILE_NAME).is_file():
            raise StudyError(f"{folder} has no {FILE_NAME}; serve the study first")
        rows = preferences(Votes(folder).all())
    if as_json:
        typer.echo(json.dumps([asdict(row) for row in rows], indent=2))
        return
    if not rows:
        typer.echo("no votes yet")
    for row in rows:
        typer.echo(
            f"{row.question:5} {row.method} preferred to {row.other}: {row.share:.0%} "
            f"(95 % interval {row.low:.0%} to {row.high:.0%}; {row.participants} participants, {row.votes} votes)"
        )
