"""The command line `dynamictree`: every command by name, imported only when it is called.

Commands of other packages (`serve`, `train`, …) come from the entry-point group `dynamictree.commands`.
"""

import importlib
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import Any

import typer
from typer.core import TyperGroup

from dynamictree.errors import DynamicTreeError

PLUGIN_GROUP = "dynamictree.commands"
OWN_COMMANDS = {
    "animate": "dynamictree.commands.animate:animate",
    "convert": "dynamictree.commands.convert:convert",
    "diffuse": "dynamictree.commands.diffuse:diffuse",
    "info": "dynamictree.commands.info:info",
    "interact": "dynamictree.commands.interact:interact",
    "reconstruct": "dynamictree.commands.reconstruct:reconstruct",
    "recut": "dynamictree.commands.recut:recut",
    "voxelize": "dynamictree.commands.voxelize:voxelize",
}


class Commands(Mapping[str, Any]):
    """Mapping of command names to commands, imported on access. Typer keeps its click private, hence no type."""

    def __init__(self) -> None:
        self._plugins = entry_points(group=PLUGIN_GROUP)

    def __getitem__(self, name: str) -> Any:
        if name in OWN_COMMANDS:
            module, attribute = OWN_COMMANDS[name].split(":")
            loaded = getattr(importlib.import_module(module), attribute)
        elif name in self._plugins.names:
            loaded = self._plugins[name].load()
        else:
            raise KeyError(name)
        if not isinstance(loaded, typer.Typer):
            loaded, function = typer.Typer(add_completion=False), loaded
            loaded.command(name)(function)
        command = typer.main.get_command(loaded)
        command.name = name
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(sorted({*OWN_COMMANDS, *self._plugins.names}))

    def __len__(self) -> int:
        return len(list(iter(self)))


class LazyGroup(TyperGroup):
    """Command group that imports a command only when it is called."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = Commands()  # type: ignore[assignment]


app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Generate the motion of captured trees, as sparse voxel spectra.",
)


@app.callback()
def _root() -> None:
    """Empty callback, which Typer requires for a group without a command of its own."""


def main() -> None:
    """Run the command line; an error that the user can correct is printed on one line, with exit status 2."""
    try:
        app()
    except DynamicTreeError as error:
        print(f"dynamictree: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
