"""Logs that name their request."""

import json
import logging

import pytest

from jobs.logging_setup import JsonLines, log_ids, set_up_logging
from jobs.settings import Settings
from service.app import serving_app


def test_a_line_is_an_object_that_names_its_ids() -> None:
    record = logging.makeLogRecord(
        {"name": "x", "levelname": "INFO", "msg": "stage %s", "args": ("a",), "cached": True}
    )
    with log_ids(request_id="r"), log_ids(job_id="j", attempt=2):
        line = json.loads(JsonLines().format(record))
    assert line.pop("time").endswith("+00:00")
    assert line == {
        "level": "INFO",
        "logger": "x",
        "message": "stage a",
        "request_id": "r",
        "job_id": "j",
        "attempt": 2,
        "cached": True,
    }
    assert "job_id" not in json.loads(JsonLines().format(record))


def test_a_traceback_stays_in_its_line() -> None:
    try:
        raise ZeroDivisionError("two\nlines")
    except ZeroDivisionError as error:
        record = logging.makeLogRecord({"msg": "failed", "exc_info": (type(error), error, error.__traceback__)})
    text = JsonLines().format(record)
    assert "\n" not in text
    assert "ZeroDivisionError" in json.loads(text)["traceback"]


def test_the_setting_chooses_the_form(capsys: pytest.CaptureFixture[str], settings: Settings) -> None:
    original = logging.root.handlers[:], logging.root.level
    try:
        set_up_logging(settings.model_copy(update={"log_format": "json"}))
        logging.getLogger("y").warning("one")
        logging.getLogger("httpx").info("a URL with its secrets")
        set_up_logging(settings)
        logging.getLogger("y").warning("two")
    finally:
        logging.root.handlers, level = original[0], original[1]
        logging.root.setLevel(level)
    first, second = capsys.readouterr().err.splitlines()
    assert json.loads(first)["message"] == "one"
    assert second.endswith("WARNING y two")


def test_variables_that_are_no_setting_are_named(tmp_path, monkeypatch, caplog) -> None:
    monkeypatch.setattr("service.app.set_up_logging", lambda _: None)
    monkeypatch.setattr("service.app.WARM_UP_AFTER_S", 3600)
    monkeypatch.setenv("DYNAMICTREE_STATE_DIR", str(tmp_path))
    for name in ("LEESE_S", "MODELS", "URL", "API_KEY"):  # weights; the last two are the client's
        monkeypatch.setenv(f"DYNAMICTREE_{name}", "1")
    serving_app()
    assert "DYNAMICTREE_LEESE_S: no such setting" in caplog.text
    assert caplog.text.count("no such setting") == 1
