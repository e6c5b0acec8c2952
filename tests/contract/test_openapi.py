from pathlib import Path

import pytest
from openapi_spec_validator import validate

from service.openapi.__main__ import main, openapi_text

COMMITTED = Path(__file__).parents[2] / "openapi" / "openapi.json"


def test_the_committed_page_is_the_applications_own() -> None:
    assert COMMITTED.read_text() == openapi_text()


def test_the_page_is_valid_openapi() -> None:
    import json

    validate(json.loads(openapi_text()))


def test_drift_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "new" / "openapi.json"
    assert main(["--check", str(page)]) == 1
    assert main(["--write", str(page)]) == 0
    assert main(["--check", str(page)]) == 0
    page.write_text("{}")
    assert main(["--check", str(page)]) == 1
    assert "make openapi" in capsys.readouterr().err
