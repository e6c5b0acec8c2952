import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dynamictree.cli import main


@pytest.fixture
def dynamictree(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """The command line, in this process; gives the exit status."""

    def call(*arguments: str | float | Path) -> int:
        monkeypatch.setattr(sys, "argv", ["dynamictree", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0)

    return call
