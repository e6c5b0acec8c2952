"""A whole service of its own, with its worker."""

from collections.abc import Iterator

import pytest

from recipes.demo import serve
from tests.servers import free_port


@pytest.fixture(scope="session")
def hook_port() -> int:
    """A port of this machine that the service may send webhooks to."""
    return free_port()


@pytest.fixture(scope="session")
def url(tmp_path_factory: pytest.TempPathFactory, hook_port: int) -> Iterator[str]:
    """Address of `dynamictree serve` with its embedded Redis, SQLite and local folder."""
    folder = tmp_path_factory.mktemp("served")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("DYNAMICTREE_OUTBOUND_HOSTS", f'["127.0.0.1:{hook_port}"]')
        with serve(folder / "state", folder / "serve.log") as url:
            yield url
