"""ZIP archives without compression: the same bytes for the same files."""

import zipfile
from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import BinaryIO


def write_stored_zip(stream: BinaryIO | BytesIO, files: Iterable[tuple[str, Sequence[bytes]]]) -> None:
    """Write an archive to a seekable stream; `files` yields name and content, in parts, and is consumed lazily."""
    with zipfile.ZipFile(stream, "w") as archive:
        for name, parts in files:  # `ZipInfo` dates every file 1980-01-01
            with archive.open(zipfile.ZipInfo(name), "w", force_zip64=True) as entry:
                for part in parts:
                    entry.write(part)
