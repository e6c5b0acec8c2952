from pathlib import Path

import pytest
from pydantic import ValidationError

from jobs.errors import SettingsError
from jobs.settings import Settings, read_settings


@pytest.mark.parametrize(
    "wrong",
    [
        {"heartbeat_s": 40},
        {"soft_time_limit_s": 9999},
        {"artifacts_url": "/srv"},
        {"database_url": "mysql://me:pw@host"},
    ],
)
def test_what_contradicts_or_opens_nothing_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=rf"^{next(iter(wrong))} (?!.*pw).* allowed; see"):
        read_settings(**wrong)


def test_a_list_that_is_no_json_is_refused_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYNAMICTREE_HOSTS", "trees.example")
    with pytest.raises(SettingsError, match=r'"hosts".*not JSON'):
        read_settings()


def test_settings_are_frozen_and_closed() -> None:
    with pytest.raises(ValidationError):
        Settings().lease_s = 1  # type: ignore[misc]
    with pytest.raises(SettingsError, match="LEESE_S"):
        read_settings(leese_s=5)


def test_a_socket_path_stays_below_the_systems_limit(tmp_path: Path) -> None:
    deep = Settings(state_dir=tmp_path / ("x" * 120))
    assert len(str(deep.redis_socket)) <= 100
    assert deep.redis_socket == Settings(state_dir=tmp_path / ("x" * 120)).redis_socket
