"""Helpers for uploads and downloads of files."""

import base64
import hashlib
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import BinaryIO

from dynamictree_client.errors import ClientError, IntegrityError
from dynamictree_client.models import Artifact

PathLike = str | Path
TUS = {"Tus-Resumable": "1.0.0"}
PIECE = 8 * 1024 * 1024  # bytes per request; a broken connection loses at most these
OUT_OF_STEP = (409, 460)  # tus: the service expects another offset; the sha256 of the whole file differs


def chosen_files(paths: PathLike | Sequence[PathLike]) -> list[Path]:
    """Return the files to send: the named ones, and all files of named folders.

    Raises:
        ClientError: there are no files.
    """
    named = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    chosen = [file for path in named for file in (sorted(path.iterdir()) if path.is_dir() else [path])]
    missing = [str(file) for file in chosen if not file.is_file()]
    if missing or not chosen:
        raise ClientError(f"no files to send: {', '.join(missing or map(str, named))}; name a mesh, or photos")
    return chosen


def form_of(files: Sequence[Path], fields: dict[str, str], stack: ExitStack) -> dict[str, object]:
    """Return a multipart form as arguments for httpx; the stack closes the files."""
    opened: list[tuple[str, tuple[str, BinaryIO]]] = [
        ("file", (file.name, stack.enter_context(file.open("rb")))) for file in files
    ]
    return {"files": opened, "data": fields}


def upload_headers(path: Path) -> dict[str, str]:
    """Return headers that create an upload (tus 1.0), with the file's sha256, which the service verifies at the end."""
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    metadata = f"filename {_base64(path.name.encode())},sha256 {_base64(digest.encode())}"
    return {**TUS, "Upload-Length": str(path.stat().st_size), "Upload-Metadata": metadata}


def piece_headers(offset: int) -> dict[str, str]:
    """Return the headers of one piece of an upload (tus 1.0)."""
    return {**TUS, "Content-Type": "application/offset+octet-stream", "Upload-Offset": str(offset)}


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def place_of(artifact: Artifact, folder: Path) -> Path:
    """Return the path for an artifact's download.

    Raises:
        IntegrityError: the name leads outside of the folder.
    """
    name = artifact.name
    if name in ("", ".", "..") or PurePosixPath(name).name != name or PureWindowsPath(name).name != name:
        raise IntegrityError(f"the service names a file {name!r}; that is no plain name, so it is not written")
    return folder / name


def bytes_there(part: Path, artifact: Artifact) -> int:
    """Return the size of an interrupted download; delete one that is too large."""
    size = part.stat().st_size if part.exists() else 0
    if size > artifact.bytes:
        part.unlink()
        return 0
    return size


def finish(part: Path, artifact: Artifact, path: Path) -> Path:
    """Rename a complete download to its final name.

    Raises:
        IntegrityError: its bytes differ from those that the service announced; they are deleted.
    """
    with part.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    if digest != artifact.sha256:
        size = part.stat().st_size
        part.unlink()
        raise IntegrityError(
            f"{artifact.name} has sha256 {digest} and {size:,} bytes; {artifact.sha256} and {artifact.bytes:,} were "
            "announced: download it again"
        )
    return part.replace(path)
