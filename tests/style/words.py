"""Words that name nothing: which are banned where, and what is allowed all the same.

Identifiers are the names that a Python file binds (functions, classes, parameters, variables, attributes, modules).
Prose is a comment or a docstring of Python, any text of the pages (`web/`) and of the documentation.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import PurePosixPath

VAGUE_NAMES = {"utils", "helpers", "common", "misc", "manager", "process", "handle", "data", "info", "flag"}
"""Banned as a whole name: they fit anything."""

VAGUE_WORDS = {"told", "held", "kept", "made", "here", "shown", "asked", "known", "found"}
"""Banned as a word of an identifier: participles that leave out what the thing is."""

BANNED_PROSE = {"told", "held", "kept"}
"""Banned in prose and in names of tests, which are sentences. There the others may stand in their plain sense."""

ALLOWED_TERMS = ("held_out", "ground_found", "not_found", "connection_made", "told_mean", "told_deviation")
"""A term of statistics, a field of the reconstruction's report, HTTP's status 404, asyncio's Protocol, and two tensors
of the shipped weights, which keep their names as long as the weights their hash."""

ALLOWED_NAMES = {
    # a page's field in the HTTP API, asyncio's parameter, hypothesis' `st.data()`
    "data": ("service/schemas/", "service/routes/", "service/http/connections.py", "tests/"),
    "process": ("",),  # of the operating system; never a function or class, see `_bound`
    "info": ("dynamictree/commands/info.py",),  # the command of that name
    "held": ("dynamictree/commands/interact.py",),  # its option `--held`, after the API's `start: held`
}
"""Where a vague name is the right one: the name, and the beginnings of the paths."""

GENERATED = (
    "client/dynamictree_client/models.py",
    "openapi/",
    "web/vendor/",
    "requirements.lock",
    "docker/requirements",
)
THIS_CHECK = ("tests/style/", "CONTRIBUTING.md")
PROSE_FILES = (".js", ".css", ".html", ".md")
_ANY_BANNED = re.compile("|".join(sorted(VAGUE_NAMES | VAGUE_WORDS)), re.IGNORECASE)
_IN_COMMENT = re.compile(rf"#.*({'|'.join(sorted(BANNED_PROSE))})", re.IGNORECASE)
_FRAGMENT = re.compile(r"\S  # (of|that|to|and|in|from|at|by|with|which|during|than|after|before|below|above) ")
REPLACEMENTS = "write reported/stated, fixed/constant, stored/retained, or name what it is"


def violations(path: str, content: bytes) -> Iterator[str]:
    """Each use of a banned word in one file, as `path:line: message`."""
    if path.startswith((*GENERATED, *THIS_CHECK)):
        return
    suffix = PurePosixPath(path).suffix
    if suffix == ".py":
        text = content.decode()
        if _ANY_BANNED.search(text) or PurePosixPath(path).stem in VAGUE_NAMES:
            yield from (f"{path}:{line}: {message}" for line, message in sorted({*_names(path, text), *_prose(text)}))
        for number, line in enumerate(text.splitlines(), start=1):
            if match := _FRAGMENT.search(line):
                yield f"{path}:{number}: a comment begins with `{match[1]}`: begin with a noun or a unit"
    elif suffix in PROSE_FILES:
        for line, text in enumerate(content.decode().splitlines(), start=1):
            yield from (f"{path}:{line}: {message}" for message in _banned_prose(text))


def _names(path: str, text: str) -> Iterator[tuple[int, str]]:
    module = PurePosixPath(path).stem
    for name, line, is_noun in ((module, 1, False), *_bound(ast.parse(text))):
        if _is_allowed(name.lower(), path, is_noun):
            continue
        if name.lower() in VAGUE_NAMES:
            yield line, f"the name `{name}` fits anything: name what it is"
        term = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
        for allowed in ALLOWED_TERMS:
            term = term.replace(allowed, "")
        banned = BANNED_PROSE if term.startswith("test_") else VAGUE_WORDS
        for word in sorted(banned.intersection(term.split("_"))):
            yield line, f"`{word}` in the name `{name}`: {REPLACEMENTS}"


def _bound(tree: ast.Module) -> Iterator[tuple[str, int, bool]]:
    """Name, line, and whether it is a noun (a variable or parameter) of each name that a module binds."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name, node.lineno, False
            case ast.arg():
                yield node.arg, node.lineno, True
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno, True
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno, True
            case ast.alias(asname=str(name)):
                yield name, node.lineno, True


def _is_allowed(name: str, path: str, is_noun: bool) -> bool:
    return name in ALLOWED_NAMES and path.startswith(ALLOWED_NAMES[name]) and (is_noun or name != "process")


def _prose(text: str) -> Iterator[tuple[int, str]]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline) if _IN_COMMENT.search(text) else ():
        if token.type == tokenize.COMMENT:
            yield from ((token.start[0], message) for message in _banned_prose(token.string))
    for node in ast.walk(ast.parse(text)):
        # A string that is a statement: a docstring, or the description under a constant.
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for line, prose in enumerate(node.value.value.splitlines(), start=node.lineno):
                yield from ((line, message) for message in _banned_prose(prose))


def _banned_prose(text: str) -> Iterator[str]:
    words = re.sub(r"held[- _]out|--held|`[^`]*`", "", text, flags=re.IGNORECASE).lower()  # a quoted name is the API's
    for word in sorted(BANNED_PROSE.intersection(re.findall(r"[a-z]+", words))):
        yield f"`{word}`: {REPLACEMENTS}"
