"""What our files of tensors and archives hold, read by safetensors and zipfile alone, as in programs of others."""

import io
import json
import zipfile
from collections.abc import Iterable, Sequence

import numpy as np
from safetensors.numpy import load

from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.gaussian.animate import AnimatedSplat
from dynamictree.gaussian.binding import Binding, Leaves
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.rotation import unit_quaternions
from dynamictree.source import Source


def animated_splat(content: bytes) -> AnimatedSplat:
    tensors, facts = load(content), json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
    floats = {name: tensor.astype(np.float32) for name, tensor in tensors.items() if tensor.dtype.kind == "f"}
    floats["quaternions"] = unit_quaternions(floats["quaternions"])
    cloud = GaussianCloud(
        **{name: floats[name] for name in ("means", "quaternions", "scales", "opacity", "sh")},
        source=Source(up_axis=facts["source_up_axis"], scale=float(facts["source_scale"])),
    )
    binding = Binding(
        cloud=cloud,
        vertices=floats["vertices"],
        triangles=tensors["triangles"],
        face_of=tensors["face_of"],
        weights=floats["weights"],
        leaves=Leaves(of=tensors["leaf_of"], vertex=tensors["leaf_vertex"]) if "leaf_of" in tensors else None,
    )
    coefficients = np.ascontiguousarray(floats["coefficients"]).view(np.complex64)[..., 0]
    return AnimatedSplat(
        binding=binding, coefficients=coefficients, num_frames=int(facts["num_frames"]), fps=float(facts["fps"])
    )


def archive_of(files: Iterable[tuple[str, Sequence[bytes]]]) -> zipfile.ZipFile:
    stream = io.BytesIO()
    write_stored_zip(stream, files)
    return zipfile.ZipFile(stream)
