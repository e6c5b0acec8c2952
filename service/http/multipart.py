"""Stream multipart/form-data to files on disk and hash them, without loading a whole part into memory."""

import re
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from email.errors import HeaderParseError
from email.header import decode_header, make_header
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO

from werkzeug.exceptions import RequestEntityTooLarge
from werkzeug.http import parse_options_header
from werkzeug.sansio import multipart

from dynamictree.photo_requests import MAX_PHOTOS
from service.http.problems import ProblemError
from service.uploads.batches import write_in_batches

MAX_FILES = 2 * MAX_PHOTOS + 40
"""Files per asset: photos, one mask per photo, and the files of known cameras."""

MAX_PARTS = MAX_FILES + 20  # files and fields
MAX_FIELD_BYTES = 4096
MAX_NAME_CHARS = 255
PIECE_BYTES = 64 * 1024
"""Bytes that are parsed at once; also the size limit for the headers of one part."""

_ENCODED_WORD = re.compile(r"(=\?[^?\s]+\?[BbQq]\?[^?\s]*\?=\s*)+")


@dataclass(frozen=True, kw_only=True)
class ReceivedFile:
    """One file part, on disk."""

    name: str  # as sent; never used as a path
    path: Path
    sha256: str
    bytes: int


@dataclass(kw_only=True)
class Form:
    """Fields and files of a form."""

    fields: dict[str, str] = field(default_factory=dict)
    files: list[ReceivedFile] = field(default_factory=list)


async def receive_form(content_type: str, body: AsyncIterator[bytes], folder: Path) -> Form:
    """Parse a multipart body; its files are written to `folder` as part-0, part-1 and so on.

    Raises:
        ProblemError: the body is no multipart/form-data, is broken, or has too many or too large parts.
    """
    kind, options = parse_options_header(content_type)
    if kind.lower() != "multipart/form-data" or not options.get("boundary"):
        raise ProblemError(
            "unsupported-format", f"Content-Type is {content_type!r}; send multipart/form-data with a boundary"
        )
    receiver = _Receiver(options["boundary"].encode(), folder)
    try:
        await write_in_batches(body, receiver.write)
        receiver.finish()
    except RequestEntityTooLarge as error:
        detail = f"at most {MAX_PARTS} parts with headers of {PIECE_BYTES:,} bytes are allowed"
        raise ProblemError("payload-too-large", detail) from error
    except ValueError as error:
        raise ProblemError("bad-request", f"the multipart body is broken or not whole: {error}") from error
    finally:
        receiver.close()
    return receiver.form


class _Receiver:
    """Incremental parser that writes the parts of a body to files, one at a time."""

    def __init__(self, boundary: bytes, folder: Path) -> None:
        self.folder = folder
        self.form = Form()
        self._decoder = multipart.MultipartDecoder(boundary, 2 * PIECE_BYTES, max_parts=MAX_PARTS)
        self._name = ""  # name of the current field or file
        self._text = b""
        self._stream: BinaryIO | None = None
        self._digest = sha256()

    def write(self, batch: list[bytes]) -> None:
        for chunk in batch:
            for at in range(0, len(chunk), PIECE_BYTES):
                self._decoder.receive_data(chunk[at : at + PIECE_BYTES])
                self._take_events()

    def finish(self) -> None:
        self._decoder.receive_data(None)
        self._take_events()

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()

    def _take_events(self) -> None:
        while not isinstance(event := self._decoder.next_event(), multipart.NeedData | multipart.Epilogue):
            if isinstance(event, multipart.Field | multipart.File):
                self._begin(event)
            elif isinstance(event, multipart.Data):
                self._add(event.data)
                if not event.more_data:
                    self._end()

    def _begin(self, part: multipart.Field | multipart.File) -> None:
        if not part.name:
            raise ProblemError("bad-request", "a part has no name in its Content-Disposition; give it one")
        self._name, self._text = _checked(part.name, "name"), b""
        if isinstance(part, multipart.File):
            self._name, self._digest = _checked(_decoded(part.filename), "filename"), sha256()
            self._stream = (self.folder / f"part-{len(self.form.files)}").open("xb")

    def _add(self, content: bytes) -> None:
        if self._stream is not None:
            self._stream.write(content)
            self._digest.update(content)
            return
        self._text += content
        if len(self._text) > MAX_FIELD_BYTES:
            detail = f"the field {self._name!r} has more than {MAX_FIELD_BYTES} bytes; send files with a filename"
            raise ProblemError("payload-too-large", detail)

    def _end(self) -> None:
        if self._stream is None:
            text = self._text.decode()
            if "\0" in text:
                raise ProblemError("bad-request", f"the field {self._name!r} holds a NUL; leave it out")
            self.form.fields[self._name] = text
            return
        path, size = Path(self._stream.name), self._stream.tell()
        self._stream.close()
        self._stream = None
        self.form.files.append(ReceivedFile(name=self._name, path=path, sha256=self._digest.hexdigest(), bytes=size))


def _decoded(name: str) -> str:
    """Decode a file name that is an encoded word (RFC 2047), as .NET's HttpClient sends it."""
    if not _ENCODED_WORD.fullmatch(name):
        return name
    try:
        return str(make_header(decode_header(name)))
    except (LookupError, ValueError, HeaderParseError) as error:
        raise ProblemError("bad-request", f"the filename {name!r} cannot be decoded; send it as UTF-8") from error


def _checked(text: str, what: str) -> str:
    if len(text) > MAX_NAME_CHARS or any(char < " " or char == "\x7f" for char in text):
        detail = f"the {what} holds a control character or is longer than {MAX_NAME_CHARS} characters"
        raise ProblemError("bad-request", detail)
    return text
