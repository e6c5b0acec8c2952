import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dynamictree.errors import InputError
from dynamictree.files import atomic_file, atomic_folder, open_input


def test_a_file_that_cannot_be_read_is_named(tmp_path) -> None:
    with pytest.raises(InputError, match=r"none\.obj cannot be read: No such file"), open_input(tmp_path / "none.obj"):
        pass


def test_what_is_published_appears_whole_over_what_was_there(tmp_path) -> None:
    out = tmp_path / "a" / "out"
    for content in ("old", "new"):
        with atomic_folder(out) as folder:
            (folder / "tree.glb").write_text(content)
            assert not (out / "tree.glb").exists() or (out / "tree.glb").read_text() == "old"
    assert [path.name for path in out.iterdir()] == ["tree.glb"]
    assert (out / "tree.glb").read_text() == "new"


def test_what_fails_leaves_what_was_there(tmp_path) -> None:
    (tmp_path / "tree.glb").write_text("old")
    for out in (tmp_path, tmp_path / "new"):
        with pytest.raises(ZeroDivisionError), atomic_folder(out) as folder:
            (folder / "tree.glb").write_text(str(1 / 0))
    assert [path.name for path in tmp_path.iterdir()] == ["tree.glb"]
    assert (tmp_path / "tree.glb").read_text() == "old"


def test_a_place_that_is_no_folder_is_reported(tmp_path) -> None:
    (tmp_path / "out").write_text("a file")
    message = r"nothing can be written to .*out: File exists; choose another"
    with pytest.raises(InputError, match=message), atomic_folder(tmp_path / "out"):
        pass


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path) -> None:
    with pytest.raises(InputError, match="no room"), atomic_folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_deleted_and_what_others_write_is_not(tmp_path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from dynamictree.files import atomic_folder\n"
        "with atomic_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'half').write_bytes(b'x'); os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=False)
    assert len(list((tmp_path / "out").glob(".partial-*/half"))) == 1
    with atomic_folder(tmp_path / "out") as first, atomic_folder(tmp_path / "out") as second:
        assert sorted((tmp_path / "out").glob(".partial-*")) == sorted([first, second])
        (first / "whole").write_bytes(b"y")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["whole"]


def test_a_full_disk_leaves_the_earlier_file(tmp_path) -> None:
    (tmp_path / "splat.npz").write_bytes(b"earlier")
    with pytest.raises(OSError, match="No space left"), atomic_file(tmp_path / "splat.npz"):
        Path("/dev/full").write_bytes(b"later")
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"earlier"]
