"""USDZ packages of files, the same bytes whenever they are written."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

NO_TIME_S = 315_576_000  # 1 January 1980 at noon: the first day that a ZIP can name


def pack_usdz(files: Sequence[Path], stream: BinaryIO) -> None:
    """Pack files of one folder, the layer first, under their own names; their times of change are set to 1980."""
    from pxr import Sdf

    package = files[0].with_suffix(".usdz")
    archive = Sdf.ZipFileWriter.CreateNew(str(package))
    for path in files:
        os.utime(path, (NO_TIME_S, NO_TIME_S))
        archive.AddFile(str(path), path.name)
    archive.Save()
    with package.open("rb") as written:
        shutil.copyfileobj(written, stream)
