"""`dynamictree`: the commands by name, each imported when it is called.

Those of other packages (`serve`, `doctor`, …) come from the entry-point group `dynamictree.commands`.
"""

import importlib
import sys
from importlib.metadata import entry_points
from typing import Any

import typer
from typer.core import TyperGroup

from dynamictree.errors import DynamicTreeError

PLUGIN_GROUP = "dynamictree.commands"
OWN_COMMANDS = {
    "animate": "dynamictree.commands.animate:animate",
    "dataset": "dynamictree.dataset.commands:app",
    "diffuse": "dynamictree.commands.diffuse:diffuse",
    "evaluate": "dynamictree.training.evaluate_command:evaluate",
    "info": "dynamictree.commands.info:info",
    "interact": "dynamictree.commands.interact:interact",
    "reconstruct": "dynamictree.commands.reconstruct:reconstruct",
    "train": "dynamictree.training.commands:train",
    "voxelize": "dynamictree.commands.voxelize:voxelize",
}


class LazyGroup(TyperGroup):
    """A group whose commands are imported when they are asked for."""

    # typer keeps its click private, so context and command have no public type
    def list_commands(self, ctx: Any) -> list[str]:
        """Name every command without importing it."""
        return sorted({*OWN_COMMANDS, *entry_points(group=PLUGIN_GROUP).names})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command; None where there is none of this name."""
        plugins = entry_points(group=PLUGIN_GROUP)
        if cmd_name in OWN_COMMANDS:
            module, attribute = OWN_COMMANDS[cmd_name].split(":")
            loaded = getattr(importlib.import_module(module), attribute)
        elif cmd_name in plugins.names:
            loaded = plugins[cmd_name].load()
        else:
            return None
        if not isinstance(loaded, typer.Typer):
            loaded, function = typer.Typer(add_completion=False), loaded
            loaded.command(cmd_name)(function)
        command = typer.main.get_command(loaded)
        command.name = cmd_name
        return command


app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Captured trees that move: a sparse voxel spectrum from a tree's shape.",
)


@app.callback()
def _root() -> None:
    """Typer wants one where a group has no command of its own."""


def main() -> None:
    """Run the command line; what the user can mend is one line and exit status 2."""
    try:
        app()
    except DynamicTreeError as error:
        print(f"dynamictree: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
