"""Sandbox for a process: no network, no other programs, no other files. Linux; no privilege needed.

Landlock (kernel 5.13) leaves it Python, its libraries and one folder; seccomp (kernel 3.17) forbids sockets, `exec`,
io_uring and access to other processes. A process that needs one program may run that one, which is confined alike. The
log names the mechanisms that a machine lacks.
"""

import ctypes
import errno
import os
import platform
import site
import struct
import sys
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Literal

PACKAGES = ("dynamictree", "jobs", "worker")
"""Packages of this project that the parser imports."""

Mechanism = Literal["landlock", "seccomp"]

_PR_SET_NO_NEW_PRIVS = 38
_PR_SET_SECCOMP = 22
_FILTER = 2
_ALLOW, _DENY = 0x7FFF_0000, 0x0005_0000 | errno.EPERM
_LOAD, _JUMP_EQUAL, _JUMP_AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_NUMBER_AT, _MACHINE_AT = 0, 4  # offsets in struct seccomp_data
_X32 = 0x4000_0000  # bit of the second system call numbering of x86_64

_MACHINES = {"x86_64": 0xC000_003E, "aarch64": 0xC000_00B7}
_DENIED = {
    "socket": (41, 198),
    "connect": (42, 203),
    "accept": (43, 202),
    "accept4": (288, 242),
    "sendto": (44, 206),
    "recvfrom": (45, 207),
    "sendmsg": (46, 211),
    "recvmsg": (47, 212),
    "bind": (49, 200),
    "listen": (50, 201),
    "socketpair": (53, 199),
    "execve": (59, 221),
    "execveat": (322, 281),
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "kill": (62, 129),
    "pidfd_open": (434, 434),
    "pidfd_getfd": (438, 438),
    "mount": (165, 40),
    "unshare": (272, 97),
    "setns": (308, 268),
    "open_by_handle_at": (304, 265),
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "keyctl": (250, 219),
    "userfaultfd": (323, 282),
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
}
"""Denied system calls and their numbers on each of `_MACHINES`."""

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_PATH_BENEATH = 1
_READ_FILE, _READ_DIR, _EXECUTE = 1 << 2, 1 << 3, 1 << 0
_FILE_BITS = _EXECUTE | 1 << 1 | _READ_FILE | 1 << 14  # the only rights that a rule for a file may have
_ACCESS_BITS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # number of access rights per version of Landlock


def confine(writable: Path, readable: Sequence[Path] = (), *, program: Path | None = None) -> tuple[Mechanism, ...]:
    """Confine this process permanently; return the mechanisms in effect.

    It may write below `writable`, and read `readable` and what Python and its libraries need. It may run `program`, a
    static executable; without Landlock in the kernel, any other executable that it can read too.

    Raises:
        OSError: the kernel offers a mechanism and then refuses it.
    """
    if sys.platform != "linux" or platform.machine() not in _MACHINES:
        return ()
    libc = ctypes.CDLL(None, use_errno=True)
    _call(libc.prctl, _PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    holds: list[Mechanism] = []
    if _restrict_files(libc, writable, readable, program):
        holds.append("landlock")
    if _filter_calls(libc, () if program is None else ("execve",)):
        holds.append("seccomp")
    return tuple(holds)


def _filter_calls(libc: ctypes.CDLL, allowed: Collection[str]) -> bool:
    program = _program(platform.machine(), allowed)
    instructions = ctypes.create_string_buffer(program, len(program))
    header = struct.pack("HxxxxxxP", len(program) // 8, ctypes.addressof(instructions))
    if libc.prctl(_PR_SET_SECCOMP, _FILTER, ctypes.create_string_buffer(header, len(header)), 0, 0) == 0:
        return True
    if ctypes.get_errno() == errno.EINVAL:
        return False  # the kernel has no seccomp
    raise OSError(ctypes.get_errno(), "seccomp")


def _program(machine: str, allowed: Collection[str] = ()) -> bytes:
    """Return the filter's instructions: calls of other architectures and denied ones fail with EPERM."""
    denied = [numbers[list(_MACHINES).index(machine)] for name, numbers in _DENIED.items() if name not in allowed]
    end = len(denied) + 2  # number of instructions from the first comparison to the denial

    def instruction(code: int, yes: int, no: int, value: int) -> bytes:
        return struct.pack("HBBI", code, yes, no, value)

    lines = [
        instruction(_LOAD, 0, 0, _MACHINE_AT),
        instruction(_JUMP_EQUAL, 0, end + 1, _MACHINES[machine]),
        instruction(_LOAD, 0, 0, _NUMBER_AT),
        instruction(_JUMP_AT_LEAST, end - 1, 0, _X32),
    ]
    lines += [instruction(_JUMP_EQUAL, len(denied) - i, 0, number) for i, number in enumerate(denied)]
    lines += [instruction(_RETURN, 0, 0, _ALLOW), instruction(_RETURN, 0, 0, _DENY)]
    return b"".join(lines)


def _restrict_files(libc: ctypes.CDLL, writable: Path, readable: Sequence[Path], program: Path | None) -> bool:
    version = libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    if version < 1:
        return False  # the kernel has no Landlock, or it is switched off
    every = (1 << _ACCESS_BITS.get(version, 16)) - 1
    # version 4 and later forbid TCP; version 6 also abstract sockets and signals to other processes
    attributes = struct.pack("QQQ", every, 3 if version >= 4 else 0, 3 if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    rules = _call(libc.syscall, _CREATE_RULESET, ctypes.create_string_buffer(attributes, 24), ctypes.c_size_t(size), 0)
    try:
        _allow(libc, rules, [writable], every & ~_EXECUTE)
        _allow(libc, rules, [*_readable(), *readable], _READ_FILE | _READ_DIR)
        _allow(libc, rules, [] if program is None else [program], _READ_FILE | _EXECUTE)
        _call(libc.syscall, _RESTRICT_SELF, rules, 0)
    finally:
        os.close(rules)
    return True


def _readable() -> Sequence[Path]:
    """Return the readable paths: Python, its libraries, our packages, files of the C library; no user's folder.

    Entries of `sys.path` are left out: one may be the current folder, or the checkout with its state and secrets.
    """
    system = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/sys/devices/system", "/dev/null", "/dev/urandom")
    kernel = ("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/sys/vm/overcommit_memory")
    libraries = [sys.base_prefix, *site.getsitepackages()]
    if sys.prefix != sys.base_prefix:
        libraries += [str(Path(sys.prefix, "lib")), str(Path(sys.prefix, "bin")), str(Path(sys.prefix, "pyvenv.cfg"))]
    if site.ENABLE_USER_SITE:
        libraries.append(site.getusersitepackages())
    own = [str(Path(__file__).parents[1] / name) for name in PACKAGES]
    return [Path(name) for name in dict.fromkeys((*system, *kernel, *libraries, *own)) if Path(name).exists()]


def _allow(libc: ctypes.CDLL, rules: int, paths: Iterable[Path], access: int) -> None:
    for path in paths:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            allowed = access if path.is_dir() else access & _FILE_BITS
            rule = ctypes.create_string_buffer(struct.pack("=Qi", allowed, descriptor), 12)
            _call(libc.syscall, _ADD_RULE, rules, _PATH_BENEATH, rule, 0)
        finally:
            os.close(descriptor)


def _call(function: "ctypes._FuncPointer", *arguments: object) -> int:
    answer = int(function(*arguments))
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer
