"""A PostgreSQL that does not answer."""

import pytest
import sqlalchemy as sa

from jobs.database import postgres_connection
from jobs.database.engine import open_engine


def test_a_statement_without_an_answer_ends_and_the_next_one_has_its_own(
    postgres_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = open_engine(postgres_url)
    with engine.connect() as connection:
        monkeypatch.setattr(postgres_connection, "ANSWER_S", 0.3)
        with pytest.raises(sa.exc.OperationalError, match="did not answer within"):
            connection.execute(sa.text("SELECT pg_sleep(2)"))
        assert connection.invalidated
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT 7")).scalar_one() == 7
    engine.dispose()
