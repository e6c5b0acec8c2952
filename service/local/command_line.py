"""Options, settings and one-line errors that the operators' commands share."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import sqlalchemy as sa
import typer

from jobs.errors import JobsError
from jobs.settings import Settings, read_settings

StateDir = Annotated[
    Path | None, typer.Option(help="Folder of the state; by default DYNAMICTREE_STATE_DIR or ./state.")
]


def settings_of(**given: object) -> Settings:
    """Return the settings of the environment; those of the command line override them.

    Raises:
        SettingsError: a value is not allowed.
    """
    return read_settings(**{name: value for name, value in given.items() if value is not None})


@contextmanager
def one_line(command: str) -> Iterator[None]:
    """Print an error that the user can correct on one line, with exit status 2."""
    try:
        yield
    except (JobsError, OSError) as error:
        _give_up(f"dynamictree {command}: {error}")
    except sa.exc.SQLAlchemyError as error:
        first_line = str(error).partition("\n")[0]
        _give_up(f"dynamictree {command}: the database does not answer: {first_line}; look at DYNAMICTREE_DATABASE_URL")


def _give_up(why: str) -> NoReturn:
    typer.echo(why, err=True)
    raise typer.Exit(2)
