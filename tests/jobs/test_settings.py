from pathlib import Path

import pytest
from pydantic import ValidationError

from jobs.errors import SettingsError
from jobs.settings import Settings, read_settings


@pytest.mark.parametrize("times", [{"heartbeat_s": 40}, {"soft_time_limit_s": 9999}])
def test_times_must_be_in_order(times: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=f"^{next(iter(times))} is .* allowed; see"):
        read_settings(**times)


def test_settings_are_frozen_and_closed() -> None:
    with pytest.raises(ValidationError):
        Settings().lease_s = 1  # type: ignore[misc]
    with pytest.raises(SettingsError, match="LEESE_S"):
        read_settings(leese_s=5)


def test_a_socket_path_stays_below_the_systems_limit(tmp_path: Path) -> None:
    deep = Settings(state_dir=tmp_path / ("x" * 120))
    assert len(str(deep.redis_socket)) <= 100
    assert deep.redis_socket == Settings(state_dir=tmp_path / ("x" * 120)).redis_socket
