"""The process that reads uploads: what goes wrong in it is reported, and ends with it."""

import asyncio
import os
import sys
from pathlib import Path

import psutil
import pytest

from jobs.settings import Settings
from jobs.storage.parser_process import ParseAnswer, ParseRequest, parse
from service.http.problems import KINDS
from tests.servers import wait_for

OBJ = "v 0.5 0 0\nv 0 0 2\nv 1 0 2\nf 1 2 3\n"


def test_a_fault_of_ours_is_reported_as_one_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    settings = Settings(state_dir=tmp_path)
    request = request_of(settings, tmp_path / "absent")
    answer = asyncio.run(parse(request, settings))
    assert (answer.code, answer.message) == ("internal-error", "The cause was logged.")
    assert "FileNotFoundError" in caplog.text


def test_modules_of_the_current_folder_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of someone's downloads may hold a `pydantic.py`."""
    (tmp_path / "pydantic.py").write_text("import pathlib; pathlib.Path(__file__).with_name('executed').touch()")
    tree = tmp_path / "scene" / "tree.obj"
    tree.parent.mkdir()
    tree.write_text(OBJ)
    monkeypatch.chdir(tmp_path)
    settings = Settings(state_dir=tmp_path)
    request = request_of(settings, tree)
    answer = asyncio.run(parse(request, settings))
    assert answer.kind == "mesh", answer
    assert not (tmp_path / "executed").exists()


def test_a_reader_that_waits_for_ever_is_ended(tmp_path: Path) -> None:
    settings = Settings(state_dir=tmp_path, parser_cpu_s=1)
    answer = asyncio.run(parse(request_of(settings, _pipe(tmp_path / "a")), settings))
    assert (answer.code, "ended with a timeout" in answer.message) == ("input-too-costly", True)
    wait_for(lambda: not _readers())


def test_an_upload_is_answered_while_another_is_read(tmp_path: Path) -> None:
    settings = Settings(state_dir=tmp_path, parser_cpu_s=10)
    first, second = _pipe(tmp_path / "a"), _pipe(tmp_path / "b")

    async def both() -> None:
        quick = asyncio.create_task(parse(request_of(settings, first), settings))
        await asyncio.to_thread(wait_for, lambda: len(_readers()) == 1)
        slow = asyncio.create_task(parse(request_of(settings, second), settings))  # forked while the first is read
        await asyncio.to_thread(wait_for, lambda: len(_readers()) == 2)
        await asyncio.to_thread(lambda: first.open("wb").close())
        assert (await quick).code == "internal-error"  # a pipe cannot be read twice
        assert not slow.done()
        slow.cancel()

    asyncio.run(both())
    wait_for(lambda: not _readers())


def test_a_server_that_was_killed_is_started_again(tmp_path: Path) -> None:
    settings = Settings(state_dir=tmp_path)
    tree = tmp_path / "tree.obj"
    tree.write_text(OBJ)
    for place in ("before", "after"):
        (tmp_path / place).mkdir()
        request = request_of(settings, tree).model_copy(update={"prepared": tmp_path / place / "prepared"})
        assert asyncio.run(parse(request, settings)).kind == "mesh"
        [server] = _servers()
        server.kill()


@pytest.mark.parametrize(("python", "why"), [("absent", "No such file"), ("/bin/false", "no process can be started")])
def test_an_upload_that_no_process_can_read_may_be_sent_again(tmp_path, monkeypatch, caplog, python, why) -> None:
    settings = Settings(state_dir=tmp_path)
    tree = tmp_path / "tree.obj"
    tree.write_text(OBJ)
    for server in _servers():
        server.kill()
    wait_for(lambda: not _servers())
    with monkeypatch.context() as broken:
        broken.setattr(sys, "executable", str(tmp_path / python))
        answer = asyncio.run(parse(request_of(settings, tree), settings))
    assert (answer.code, KINDS["overloaded"].status) == ("overloaded", 503)
    assert why in caplog.text
    assert asyncio.run(parse(request_of(settings, tree), settings)).kind == "mesh"


def test_what_the_kernel_does_not_confine_is_logged_once(tmp_path, monkeypatch, caplog) -> None:
    async def answered(_: ParseRequest) -> bytes:
        return ParseAnswer(kind="mesh", lacks=("landlock",)).model_dump_json().encode() + b"\n0"

    monkeypatch.setattr("jobs.storage.parser_process._content", answered)
    settings = Settings(state_dir=tmp_path)
    for _ in range(2):
        assert asyncio.run(parse(request_of(settings, tmp_path), settings)).kind == "mesh"
    assert caplog.text.count("uploads are read without landlock") == 1


def test_a_reader_ends_with_its_server(tmp_path: Path) -> None:
    settings = Settings(state_dir=tmp_path, parser_cpu_s=10)
    request = request_of(settings, _pipe(tmp_path / "a"))

    async def cut_off() -> None:
        reading = asyncio.create_task(parse(request, settings))
        await asyncio.to_thread(wait_for, lambda: len(_readers()) == 1)
        [reader], [server] = _readers(), _servers()
        server.kill()
        await asyncio.to_thread(wait_for, lambda: not reader.is_running())
        reading.cancel()

    asyncio.run(cut_off())
    wait_for(lambda: not _readers())


def request_of(settings: Settings, tree: Path, name: str = "tree.obj") -> ParseRequest:
    return ParseRequest(
        kind="mesh",
        names=(name,),
        paths=(tree,),
        prepared=tree.parent / "prepared",
        memory_bytes=settings.parser_memory_bytes,
        cpu_s=settings.parser_cpu_s,
    )


def _pipe(folder: Path) -> Path:
    """A file that is read for ever, until somebody writes into it."""
    folder.mkdir()
    os.mkfifo(folder / "tree.obj")
    return folder / "tree.obj"


def _servers() -> list[psutil.Process]:
    alive = [one for one in psutil.Process().children() if one.status() != psutil.STATUS_ZOMBIE]
    return [one for one in alive if "worker.parse_server" in one.cmdline()]


def _readers() -> list[psutil.Process]:
    return [fork for server in _servers() for fork in server.children()]
