"""Ways in which a file goes wrong: by chance, by half, by intent. All from one generator, so that a case repeats."""

import gzip
import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable

from tests.fuzz.seeds import inflate

NUMBERS = (0, 1, 2, 3, 7, 127, 128, 255, 256, 32767, 65535, 65536, 10**6)
NUMBERS += (2**31 - 1, 2**31, 2**32 - 1, 2**53, 2**63, -1, -2)
WORDS = ("nan", "inf", "-inf", "1e308", "1e-320", "-0", "0", "-1", "1e9", "99999999999999999999", "2147483648")
WORDS += ("4294967295", "x", "null", "true", "[]", "{}", "0.5", '"a"', "../../etc/passwd", "/etc/passwd")
WORDS += ("http://127.0.0.1/", "\x00")
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
_TOKEN = re.compile(rb"[A-Za-z_0-9.+-]+")
Change = Callable[[bytearray, random.Random], None]


def mutated(content: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """One to six changes; inside of a container half of the time, so that its outer shell stays sound."""
    opened = rng.random() < 0.5
    if opened and content[:4] == b"PK\x03\x04":
        return _in_zip(content, rng)
    if opened and content[:2] == b"\x1f\x8b" and (inner := inflate(content)) is not None:
        return gzip.compress(_changed(inner, [], rng), 1, mtime=0)
    if opened and content[:4] == b"glTF" and len(content) > 20:
        return _in_glb(content, rng)
    if opened and content[8:9] == b"{":
        return _in_safetensors(content, rng)
    return _changed(content, others, rng)


def _changed(content: bytes, others: list[bytes], rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        if not changed:
            break
        rng.choice(CHANGES)(changed, rng)
    if others and rng.random() < 0.05:
        other = rng.choice(others)
        changed = changed[: rng.randrange(len(changed) + 1)] + other[rng.randrange(len(other) + 1) :]
    return bytes(changed)


def _in_zip(content: bytes, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    chosen = rng.randrange(len(files))
    name, inner = files[chosen]
    if rng.random() < 0.15:
        name = rng.choice(
            ("../" + name, "/" + name, "a\\..\\" + name, name.upper(), "a" * 300, name + ".zip", "é" + name)
        )
    files[chosen] = (name, _changed(inner, [], rng))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, inner in files:
            archive.writestr(name, inner)
    return stream.getvalue()


def _in_glb(content: bytes, rng: random.Random) -> bytes:
    """Another document in the same shell, lengths right."""
    length = struct.unpack_from("<I", content, 12)[0]
    text = _json_changed(content[20 : 20 + length], rng)
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    return b"glTF" + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest


def _in_safetensors(content: bytes, rng: random.Random) -> bytes:
    length = int.from_bytes(content[:8], "little")
    text = _json_changed(content[8 : 8 + length], rng)
    return len(text).to_bytes(8, "little") + text + content[8 + length :]


def _json_changed(text: bytes, rng: random.Random) -> bytes:
    """One value of a JSON document replaced, taken out or doubled; or its text changed."""
    if rng.random() < 0.3:
        return _changed(text, [], rng)
    root = json.loads(text)
    places: list[tuple[object, object]] = []

    def walk(node: object) -> None:
        keys = node.keys() if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        for key in keys:
            places.append((node, key))
            walk(node[key])

    walk(root)
    for _ in range(rng.choice((1, 1, 2, 3))):
        node, key = rng.choice(places)
        match rng.randrange(4):
            case 0 if isinstance(node, dict):
                node.pop(key, None)
            case 1 if isinstance(node, list):
                node.append(rng.choice(node) if node else 0)
            case 2:
                _put(node, key, rng.choice((*NUMBERS, 0.5, 1e308, -1e308)))
            case _:
                _put(
                    node,
                    key,
                    rng.choice((None, True, "", "VEC3", "SCALAR", [], {}, [0, 0, 0], [1e9] * 16, {"a": 1}, "x" * 999)),
                )
    return json.dumps(root).encode()


def _put(node: object, key: object, value: object) -> None:
    if isinstance(node, dict) or (isinstance(node, list) and isinstance(key, int) and key < len(node)):
        node[key] = value


def flip_bit(content: bytearray, rng: random.Random) -> None:
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)


def random_bytes(content: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(content))
    size = rng.randrange(1, 17)
    content[at : at + size] = rng.randbytes(size)


def number(content: bytearray, rng: random.Random) -> None:
    """A telling integer in place of the bytes that are there, most often near the head."""
    size = rng.choice((1, 2, 4, 8))
    at = rng.randrange(min(len(content), 200) if rng.random() < 0.6 else len(content))
    value = rng.choice(NUMBERS) % (1 << (8 * size))
    content[at : at + size] = value.to_bytes(size, rng.choice(("little", "little", "big")))


def float_value(content: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(content)) & ~3
    content[at : at + 4] = struct.pack("<f", rng.choice((float("nan"), float("inf"), 3e38, -3e38, 1e-40, -0.0)))


def truncate(content: bytearray, rng: random.Random) -> None:
    del content[rng.randrange(len(content)) :]


def cut_out(content: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(content))
    del content[at : at + rng.randrange(1, 64)]


def double(content: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(content))
    piece = content[at : at + rng.randrange(1, 200)]
    content[at:at] = piece * rng.choice((1, 1, 2, 50))


def word(content: bytearray, rng: random.Random) -> None:
    """A number or name of a text, near the head as a rule, becomes another."""
    window = 2000 if rng.random() < 0.6 else len(content)
    pattern = _NUMBER if rng.random() < 0.7 else _TOKEN
    matches = list(pattern.finditer(bytes(content[:window])))
    if matches:
        chosen = rng.choice(matches)
        content[chosen.start() : chosen.end()] = rng.choice((*WORDS, *map(str, NUMBERS))).encode()


def swap_lines(content: bytearray, rng: random.Random) -> None:
    lines = bytes(content).split(b"\n")
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]
    content[:] = b"\n".join(lines)


CHANGES: tuple[Change, ...] = (flip_bit, random_bytes, number, number, float_value, truncate, cut_out, double)
CHANGES += (word, word, swap_lines)
