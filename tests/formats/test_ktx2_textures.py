"""Textures in KTX 2: two by another program (alktx2 0.1.7), 8 × 8 pixels, left green, right a brown without cover."""

import base64
import io
import struct

import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import FormatError
from dynamictree.formats.companions import KTX2_MAGIC
from dynamictree.formats.gltf import material
from tests.formats.test_companions import read, textured

ETC1S = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAACAAAAAAAAAAAAAAAAQAAAAEAAAABAAAAaAAAADwAAACkAAAAJAAAAMgAAAAAAAAAkQAA"
    "AAAAAABZAQAAAAAAAAQAAAAAAAAAAAAAAAAAAAA8AAAAAAAAAAIAOACjAQIAAwMAAAgIAAAAAAAAAAA/AAAAAAAAAAAA/////0AA"
    "Pw8AAAAAAAAAAP////8fAAAAS1RYd3JpdGVyAEJhc2lzIFVuaXZlcnNhbCAyLjEwAAAEAAMAMAAAAA0AAAAsAAAAAAAAAAAAAAAA"
    "AAAAAgAAAAIAAAACAAAAIMCUAAAAAAAAEgxBAUwBEAAAAABBuyc0AcwAAAAAAABBNG0JABMAAAAAAAAIwLkH/P///1dVVVUFAAAA"
    "AGDARAAAAAAAAJKKAJgAEAAAAABAlASYEDAAAAAIwqaPQgAwAQAAAAAAgAACrgB4AQ=="
)
UASTC = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAACAAAAAAAAAAAAAAAAQAAAAEAAAAAAAAAaAAAACwAAACUAAAALAAAAAAAAAAAAAAAAAAA"
    "AAAAAADAAAAAAAAAAEAAAAAAAAAAQAAAAAAAAAAsAAAAAAAAAAIAKACmAQIAAwMAABAAAAAAAAAAAAB/AwAAAAAAAAAA/////x8A"
    "AABLVFh3cml0ZXIAQmFzaXMgVW5pdmVyc2FsIDIuMTAAAAQAAAB/fwAAFwWU518NSAAAAAAAAAAAANdSCwVghmkAAAAAAAAAAAAX"
    "BZTnXw1IAAAAAAAAAAAA11ILBWCGaQAAAAAAAAAAAA=="
)
GREEN, BROWN = (40, 160, 60, 255), (150, 90, 40, 0)
BASIS = {"extensions": {"KHR_texture_basisu": {"source": 0}}}


@pytest.mark.parametrize("content", [ETC1S, UASTC], ids=["ETC1S", "UASTC"])
def test_a_texture_has_the_colours_and_the_cover_that_it_was_made_of(content: bytes) -> None:
    model, binary = textured("bark.ktx2", **BASIS)
    mesh = read(model, {"scene.bin": binary, "bark.ktx2": content})
    assert mesh.warnings == ()
    pixels = np.asarray(Image.open(io.BytesIO(mesh.look.materials[0].texture_png))).astype(int)
    assert pixels.shape == (8, 8, 4)
    assert np.abs(pixels[:, :4] - GREEN).max() <= 2
    assert np.abs(pixels[:, 4:] - BROWN).max() <= 2


def test_without_the_transcoder_a_texture_is_left_out_with_a_warning(monkeypatch) -> None:
    monkeypatch.setattr(material, "has_ktx2", lambda: False)
    model, binary = textured("bark.ktx2")
    mesh = read(model, {"scene.bin": binary, "bark.ktx2": ETC1S})
    assert [warning.code for warning in mesh.warnings] == ["texture-not-read"]
    assert mesh.look.materials[0].texture_png is None


@pytest.mark.parametrize("content", [KTX2_MAGIC, KTX2_MAGIC + bytes(100), ETC1S[:200], UASTC[:-40]])
def test_a_damaged_texture_is_an_error_with_its_name(content: bytes) -> None:
    with pytest.raises(FormatError, match=r"texture 'bark\.ktx2' cannot be transcoded"):
        material.ktx2_as_png(content, "bark.ktx2")


def test_a_texture_of_too_many_pixels_is_refused_before_it_is_transcoded() -> None:
    vast = ETC1S[:20] + struct.pack("<II", 100_000, 100_000) + ETC1S[28:]
    with pytest.raises(FormatError, match="100000 x 100000 pixels"):
        material.ktx2_as_png(vast, "bark.ktx2")
