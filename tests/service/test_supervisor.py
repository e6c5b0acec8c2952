import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from service.local.supervisor import ChildPlan, Supervisor
from tests.servers import wait_for


def plan(program: str, name: str = "child", **values: Any) -> ChildPlan:
    return ChildPlan(name=name, command=[sys.executable, "-c", program], environment=os.environ, **values)


@contextmanager
def running(*plans: ChildPlan, announce: Callable[[], bool] = lambda: True) -> Iterator[Supervisor]:
    """A supervisor in a thread, which stops at the end."""
    supervisor, done = Supervisor([*plans]), threading.Event()
    thread = threading.Thread(target=supervisor.run, args=(done,), kwargs={"announce": announce})
    thread.start()
    try:
        yield supervisor
    finally:
        done.set()
        thread.join(30)


def pids_in(path: Path, count: int) -> list[int]:
    wait_for(lambda: path.exists() and len(path.read_text().split()) >= count, f"{count} lines in {path}", 60)
    return [int(line) for line in path.read_text().split()]


def test_a_child_that_dies_starts_again(tmp_path: Path) -> None:
    log = tmp_path / "pids"
    program = f"import os, time; open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n'); time.sleep(100)"
    with running(plan(program)) as supervisor:
        first = pids_in(log, 1)[0]
        os.kill(first, signal.SIGKILL)
        second = pids_in(log, 2)[1]
        assert supervisor.children[0].restarts == 1
    assert not psutil.pid_exists(first)
    assert not psutil.pid_exists(second)


def test_it_announces_once() -> None:
    answers, given = iter([False, False, True]), list[int]()
    with running(plan("import time; time.sleep(100)"), announce=lambda: given.append(1) or next(answers)):
        wait_for(lambda: len(given) == 3, "three polls", 60)
        time.sleep(0.5)
    assert len(given) == 3


def test_one_that_keeps_dying_is_started_ever_more_rarely(tmp_path: Path, monkeypatch, caplog) -> None:
    monkeypatch.setattr("service.local.supervisor.FIRST_BACKOFF_S", 0.2)
    log = tmp_path / "pids"
    program = f"import os; open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n')"
    with running(plan(program)):
        began = time.monotonic()
        pids_in(log, 3)
        assert time.monotonic() - began > 0.2 + 0.4
    assert [record.args[-1] for record in caplog.records[:2]] == [0.2, 0.4]  # announced pauses [s]


def test_one_that_does_not_stop_is_killed_with_what_it_started(tmp_path: Path) -> None:
    log = tmp_path / "pids"
    deaf = (
        "import os, signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
        f"p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(100)']);"
        f"open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n{{p.pid}}\\n'); time.sleep(100)"
    )
    with running(plan(deaf, grace_s=0.2)):
        pids = pids_in(log, 2)
    wait_for(
        lambda: not any(psutil.pid_exists(p) and psutil.Process(p).status() != "zombie" for p in pids), "their end"
    )


def test_children_start_in_order_and_stop_in_reverse(tmp_path: Path) -> None:
    log = tmp_path / "log"
    program = (
        "import signal, sys, time\n"
        f"def say(word): open({str(log)!r}, 'a').write(f'{{word}} ')\n"
        "def stop(*_):\n say('-NAME'); sys.exit()\n"
        "signal.signal(signal.SIGTERM, stop); say('+NAME'); time.sleep(100)"
    )
    first = plan(program.replace("NAME", "a"), "a", ready=log.exists, grace_s=20)
    second = plan(program.replace("NAME", "b"), "b", grace_s=20)
    with running(first, second):
        wait_for(lambda: log.exists() and "+b" in log.read_text(), "b")
    assert log.read_text().split() == ["+a", "+b", "-b", "-a"]
