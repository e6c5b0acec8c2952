"""Stream multipart/form-data to files on disk and hash them; no part is ever whole in memory."""

import re
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from email.errors import HeaderParseError
from email.header import decode_header, make_header
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote_to_bytes

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from dynamictree.photo_requests import MAX_PHOTOS
from service.http.problems import ProblemError
from service.uploads.batches import write_in_batches

MAX_FILES = 2 * MAX_PHOTOS + 40
"""Of one asset, however it is sent: photos, a mask for each, and the files of known cameras."""

MAX_PARTS = MAX_FILES + 20  # and the fields
MAX_FIELD_BYTES = 4096
MAX_NAME_CHARS = 255
_EXTENDED_NAME = re.compile(rb";\s*filename\*\s*=\s*utf-8'[^';]*'([^;\s]+)", re.IGNORECASE)
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
        ProblemError: it is no multipart/form-data, is broken, or has too many or too large parts.
    """
    kind, options = parse_options_header(content_type)
    if kind != b"multipart/form-data" or not options.get(b"boundary"):
        raise ProblemError(
            "unsupported-format", f"Content-Type is {content_type!r}; send multipart/form-data with a boundary"
        )
    receiver = _Receiver(folder)
    parser = MultipartParser(options[b"boundary"], receiver.callbacks())
    try:
        await write_in_batches(body, lambda batch: parser.write(b"".join(batch)))
        parser.finalize()
    except FormParserError as error:
        raise ProblemError("bad-request", f"the multipart body is broken: {error}") from error
    finally:
        receiver.close()
    if not receiver.ended:
        raise ProblemError("bad-request", "the multipart body ends before its last boundary; send it whole")
    return receiver.form


class _Receiver:
    """Callbacks of the parser; one part at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.form = Form()
        self.ended = False
        self._parts = 0
        self._header_name = b""
        self._header_value = b""
        self._headers: dict[bytes, bytes] = {}
        self._field = ""
        self._filename: str | None = None
        self._text = b""
        self._stream: BinaryIO | None = None
        self._digest = sha256()

    def callbacks(self) -> Any:  # a TypedDict that the library has for type checkers only
        return {
            "on_part_begin": self._begin,
            "on_header_field": self._on_header_name,
            "on_header_value": self._on_header_value,
            "on_header_end": self._end_header,
            "on_headers_finished": self._open,
            "on_part_data": self._write,
            "on_part_end": self._end,
            "on_end": self._finish,
        }

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()

    def _begin(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise ProblemError("payload-too-large", f"the body has more than {MAX_PARTS} parts, which are allowed")
        self._headers = {}
        self._text = b""

    def _on_header_name(self, content: bytes, start: int, end: int) -> None:
        self._header_name += content[start:end]

    def _on_header_value(self, content: bytes, start: int, end: int) -> None:
        self._header_value += content[start:end]

    def _end_header(self) -> None:
        self._headers[self._header_name.lower()] = self._header_value
        self._header_name = self._header_value = b""

    def _open(self) -> None:
        disposition = self._headers.get(b"content-disposition", b"")
        _, options = parse_options_header(disposition)
        if b"name" not in options:
            raise ProblemError("bad-request", f"part {self._parts} has no name in its Content-Disposition; give it one")
        self._field = _text(options[b"name"], "name")
        self._filename = _file_name(disposition, options)
        if self._filename is not None:
            self._digest = sha256()
            self._stream = (self.folder / f"part-{len(self.form.files)}").open("xb")

    def _write(self, content: bytes, start: int, end: int) -> None:
        piece = content[start:end]
        if self._stream is not None:
            self._stream.write(piece)
            self._digest.update(piece)
            return
        self._text += piece
        if len(self._text) > MAX_FIELD_BYTES:
            detail = f"the field {self._field!r} has more than {MAX_FIELD_BYTES} bytes; send files with a filename"
            raise ProblemError("payload-too-large", detail)

    def _end(self) -> None:
        if self._stream is None:
            self.form.fields[self._field] = _text(self._text, f"field {self._field!r}")
            return
        size = self._stream.tell()
        self._stream.close()
        assert self._filename is not None
        received = ReceivedFile(
            name=self._filename, path=Path(self._stream.name), sha256=self._digest.hexdigest(), bytes=size
        )
        self.form.files.append(received)
        self._stream = None

    def _finish(self) -> None:
        self.ended = True


def _file_name(disposition: bytes, options: Mapping[bytes, bytes]) -> str | None:
    """What a part's file is called; None where it is a field.

    `filename*` (RFC 8187) comes first; .NET's HttpClient writes an encoded word (RFC 2047) into `filename` beside it.
    """
    extended = _EXTENDED_NAME.search(disposition)
    if extended is not None:
        return _text(unquote_to_bytes(extended[1]), "filename")
    if b"filename" not in options:
        return None
    name = _text(options[b"filename"], "filename")
    if not _ENCODED_WORD.fullmatch(name):
        return name
    try:
        return _text(str(make_header(decode_header(name))).encode(), "filename")
    except (LookupError, ValueError, HeaderParseError) as error:
        raise ProblemError("bad-request", f"the filename {name!r} cannot be decoded; send it as UTF-8") from error


def _text(content: bytes, what: str) -> str:
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise ProblemError("bad-request", f"the {what} is not UTF-8; encode it so") from error
    if "\0" in text or (what in {"name", "filename"} and not is_name(text)):
        detail = f"the {what} holds a control character or is longer than {MAX_NAME_CHARS} characters"
        raise ProblemError("bad-request", detail)
    return text


def is_name(text: str) -> bool:
    """Whether a text can be shown and logged as a file's name."""
    return len(text) <= MAX_NAME_CHARS and not any(char < " " or char == "\x7f" for char in text)
