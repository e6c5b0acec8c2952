import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from service.local.supervisor import ChildPlan, Supervisor


def plan(program: str, name: str = "child", grace_s: float = 5.0) -> ChildPlan:
    command = [sys.executable, "-c", program]
    return ChildPlan(name=name, command=command, environment=os.environ, grace_s=grace_s)


@contextmanager
def running(*plans: ChildPlan) -> Iterator[Supervisor]:
    """A supervisor in a thread, which stops at the end."""
    supervisor, done = Supervisor([*plans]), threading.Event()
    thread = threading.Thread(target=supervisor.run, args=(done,), kwargs={"poll_s": 0.02})
    thread.start()
    try:
        yield supervisor
    finally:
        done.set()
        thread.join(30)


def wait_for(path: Path, count: int) -> list[int]:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        pids = [int(line) for line in path.read_text().split()] if path.exists() else []
        if len(pids) >= count:
            return pids
        time.sleep(0.02)
    raise AssertionError(f"{path} did not get {count} lines")


def test_a_child_that_dies_starts_again(tmp_path: Path) -> None:
    log = tmp_path / "pids"
    program = f"import os, time; open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n'); time.sleep(100)"
    with running(plan(program)) as supervisor:
        first = wait_for(log, 1)[0]
        os.kill(first, signal.SIGKILL)
        second = wait_for(log, 2)[1]
        assert supervisor.children[0].restarts == 1
    assert not psutil.pid_exists(first)
    assert not psutil.pid_exists(second)


def test_one_that_keeps_dying_is_started_ever_more_rarely(tmp_path: Path) -> None:
    log = tmp_path / "pids"
    program = f"import os; open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n')"
    with running(plan(program)):
        began = time.monotonic()
        wait_for(log, 3)
        assert time.monotonic() - began > 0.5 + 1.0


def test_one_that_does_not_stop_is_killed_with_what_it_started(tmp_path: Path) -> None:
    log = tmp_path / "pids"
    deaf = (
        "import os, signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
        f"p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(100)']);"
        f"open({str(log)!r}, 'a').write(f'{{os.getpid()}}\\n{{p.pid}}\\n'); time.sleep(100)"
    )
    with running(plan(deaf, grace_s=0.2)):
        pids = wait_for(log, 2)
    deadline = time.monotonic() + 60
    while any(psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie" for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_children_start_in_order_and_stop_in_reverse(tmp_path: Path) -> None:
    log = tmp_path / "log"
    program = (
        "import signal, sys, time\n"
        f"def say(word): open({str(log)!r}, 'a').write(f'{{word}} ')\n"
        "def stop(*_):\n say('-NAME'); sys.exit()\n"
        "signal.signal(signal.SIGTERM, stop); say('+NAME'); time.sleep(100)"
    )
    first = ChildPlan(
        name="a",
        command=[sys.executable, "-c", program.replace("NAME", "a")],
        environment=os.environ,
        ready=log.exists,
        grace_s=20,
    )
    second = plan(program.replace("NAME", "b"), "b", grace_s=20)
    with running(first, second):
        deadline = time.monotonic() + 30
        while not (log.exists() and "+b" in log.read_text()):
            assert time.monotonic() < deadline
            time.sleep(0.02)
    assert log.read_text().split() == ["+a", "+b", "-b", "-a"]
