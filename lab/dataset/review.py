"""Manual verdicts on trees: lines of `SEED accept` or `SEED reject`. Paper appendix A, step 3."""

from collections.abc import Mapping
from typing import Literal, get_args

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import FormatError

Verdict = Literal["accept", "reject"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
HEADER = "# SEED accept|reject, and what you like after it; `dynamictree dataset generate --review` honours this file\n"


def read_review(stream: ByteReader) -> dict[int, Verdict]:
    """Read the verdict of each seed; text after a # or the verdict is a note.

    Raises:
        FormatError: a line is no verdict; the message gives its number.
    """
    verdicts: dict[int, Verdict] = {}
    try:
        text = stream.read().decode()
    except UnicodeDecodeError as error:
        raise FormatError(f"the review file is no text ({error}); write it in UTF-8") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        verdict = next((allowed for allowed in VERDICTS if len(words) > 1 and words[1] == allowed), None)
        if not words[0].isdigit() or verdict is None:
            raise FormatError(f"line {number} of the review file is {line!r}; write `SEED accept` or `SEED reject`")
        verdicts[int(words[0])] = verdict
    return verdicts


def write_review(
    verdicts: Mapping[int, Verdict], stream: ByteWriter, *, notes: Mapping[int, str] | None = None
) -> None:
    """Write verdicts in the order of seeds."""
    stream.write(HEADER.encode())
    for seed in sorted(verdicts):
        note = (notes or {}).get(seed, "")
        stream.write(f"{seed} {verdicts[seed]} {note}".rstrip().encode() + b"\n")
