"""ZIP archives that are stored, not packed: the same bytes for the same files."""

import zipfile
from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import BinaryIO


def write_stored_zip(stream: BinaryIO | BytesIO, files: Iterable[tuple[str, Sequence[bytes]]]) -> None:
    """Write an archive to a stream that can seek. Files are name and content in parts, and are asked for one by one."""
    with zipfile.ZipFile(stream, "w") as archive:
        for name, parts in files:  # whose date is the first of 1980, whatever the clock says
            with archive.open(zipfile.ZipInfo(name), "w", force_zip64=True) as entry:
                for part in parts:
                    entry.write(part)
