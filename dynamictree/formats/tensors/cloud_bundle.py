"""`cloud.safetensors`: a `Capture` as one process hands it to another, in metres and +Z up.

Internal: written by the process that parses an upload, read by those that must not parse it again.
"""

import json
from dataclasses import asdict
from io import BytesIO

import numpy as np
from jaxtyping import Shaped

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.formats.tensors.container import number, offset_of, read_tensors, take_tensor, write_tensors
from dynamictree.formats.tensors.mesh_bundle import read_mesh_bundle, write_mesh_bundle
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import StillPart
from dynamictree.plant.capture import Capture
from dynamictree.source import Source

FORMAT, VERSION = "cloud-bundle", "1"
MAX_BYTES = 3 << 30
_SHAPES: dict[str, tuple[int | None, ...]] = {
    "means": (None, 3),
    "quaternions": (None, 4),
    "scales": (None, 3),
    "opacity": (None,),
    "sh": (None, None, 3),
}


def write_cloud_bundle(capture: Capture, stream: ByteWriter) -> None:
    """Write everything, exactly."""
    cloud = capture.cloud
    tensors: dict[str, Shaped[np.ndarray, ...]] = {name: getattr(cloud, name) for name in _SHAPES}
    if capture.mask is not None:
        tensors["mask"] = capture.mask.astype(np.uint8)
    if capture.tree is not None:
        tensors["tree"] = capture.tree
    if capture.mesh is not None:
        packed = BytesIO()
        write_mesh_bundle(capture.mesh, packed)
        tensors["mesh"] = np.frombuffer(packed.getvalue(), np.uint8)
    if capture.part_of is not None:
        tensors["part_of"] = capture.part_of
    source = {"source_up_axis": cloud.source.up_axis, "source_scale": repr(float(cloud.source.scale))}
    source["source_offset"] = json.dumps(cloud.source.offset)
    source["still_parts"] = json.dumps([asdict(part) for part in capture.still_parts])
    write_tensors(stream, tensors, {"format": FORMAT, "version": VERSION} | source)


def read_cloud_bundle(stream: ByteReader) -> Capture:
    """Undo `write_cloud_bundle`.

    Raises:
        FormatError: it is no such file, or of another version.
        InputError: what is in it cannot be used.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION, max_bytes=MAX_BYTES)
    parts = {name: take_tensor(tensors, name, dtypes=("float32",), shape=shape) for name, shape in _SHAPES.items()}
    mask = take_tensor(tensors, "mask", dtypes=("uint8",), shape=(None,)) if "mask" in tensors else None
    parts_text = metadata.get("still_parts", "[]")
    part_of = take_tensor(tensors, "part_of", dtypes=("uint8",), shape=(None,)) if "part_of" in tensors else None
    return Capture(
        cloud=GaussianCloud(
            **parts,  # type: ignore[arg-type]  # their names are those of arrays
            source=Source(
                up_axis=metadata["source_up_axis"], scale=number(metadata, "source_scale"), offset=offset_of(metadata)
            ),
        ),
        mask=None if mask is None else mask.astype(np.bool_),
        tree=take_tensor(tensors, "tree", dtypes=("int32",), shape=(None,)) if "tree" in tensors else None,
        mesh=read_mesh_bundle(BytesIO(tensors["mesh"].tobytes()), with_source=True) if "mesh" in tensors else None,
        still_parts=tuple(StillPart(**part) for part in json.loads(parts_text)),
        part_of=part_of,
    )
