import io

import pytest

from dynamictree.errors import FormatError
from lab.dataset.review import read_review, write_review


def test_reading_undoes_writing():
    verdicts = {5: "reject", 3: "accept"}
    stream = io.BytesIO()
    write_review(verdicts, stream, notes={5: "clustered branches"})
    stream.seek(0)
    assert read_review(stream) == verdicts
    assert b"5 reject clustered branches\n" in stream.getvalue()


def test_notes_comments_and_empty_lines_are_passed_over():
    text = b"# a comment\n\n12 reject too dense # really\n13 accept\n"
    assert read_review(io.BytesIO(text)) == {12: "reject", 13: "accept"}


@pytest.mark.parametrize("line", ["12", "12 maybe", "tree accept", "-1 accept"])
def test_a_line_that_is_no_verdict_is_refused_by_its_number(line):
    with pytest.raises(FormatError, match="line 2"):
        read_review(io.BytesIO(f"1 accept\n{line}\n".encode()))


def test_what_is_no_text_is_refused():
    with pytest.raises(FormatError, match="no text"):
        read_review(io.BytesIO(b"\xff\xfe\x00"))
