"""A motion as Alembic (Ogawa): a polygon mesh with a sample per frame, texture coordinates and a face set per material.

+Y up and metres, as Alembic's readers expect; vertices in the source's order. Needs alembic3d, the extra `alembic`.
"""

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float32

from dynamictree.mesh import TriangleMesh
from dynamictree.up_axis import up_rotation, vertices_in_source_axes


def write_motion_alembic(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], stream: BinaryIO, *, fps: float
) -> None:
    """Write the mesh and its displacements [m]; the first frame is at time 0."""
    with tempfile.TemporaryDirectory(prefix="dynamictree-alembic-") as folder:
        path = Path(folder) / "tree.abc"
        _write_archive(mesh, frames, str(path), fps)  # the file is complete when the archive is no longer referenced
        with path.open("rb") as written:
            shutil.copyfileobj(written, stream)


def _write_archive(mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], path: str, fps: float) -> None:
    import imath  # part of alembic3d's wheel
    from alembic3d import Abc, AbcCoreAbstract, AbcGeom

    archive = Abc.OArchive(path)  # without the date that CreateArchiveWithInfo adds: equal input gives equal bytes
    clock = archive.addTimeSampling(AbcCoreAbstract.TimeSampling(1 / fps, 0.0))
    schema = AbcGeom.OPolyMesh(archive.getTop(), "tree", clock).getSchema()
    corners = _integers(mesh.faces[:, ::-1])  # Alembic's faces run clockwise
    counts = _integers(np.full(mesh.num_faces, 3))
    rest, rotation = vertices_in_source_axes(mesh.vertices, "+Y"), up_rotation("+Y").astype(np.float32)
    for frame, displacement in enumerate(frames):
        points = imath.V3fArrayFromBuffer(np.ascontiguousarray(rest + displacement @ rotation, np.float32))
        if frame:
            schema.set(AbcGeom.OPolyMeshSchemaSample(points))
            continue
        sample = AbcGeom.OPolyMeshSchemaSample(points, corners, counts)
        if mesh.look.uv is not None:
            coordinates = imath.V2fArrayFromBuffer(np.ascontiguousarray(mesh.look.uv * [1, -1] + [0, 1], np.float32))
            scope = AbcGeom.GeometryScope.kFacevaryingScope
            sample.setUVs(AbcGeom.OV2fGeomParamSample(coordinates, _indices(mesh.faces[:, ::-1]), scope))
        schema.set(sample)
        _add_face_sets(schema, mesh)


def _add_face_sets(schema: Any, mesh: TriangleMesh) -> None:
    from alembic3d import AbcGeom

    if not mesh.look.materials:
        return
    names = face_set_names([material.name for material in mesh.look.materials])
    for number in np.unique(mesh.material_of_face).tolist():
        chosen = _integers(np.flatnonzero(mesh.material_of_face == number))
        schema.createFaceSet(names[number]).getSchema().set(AbcGeom.OFaceSetSchemaSample(chosen))


def face_set_names(names: list[str]) -> list[str]:
    """Return names of face sets for materials: unique, and without characters that Alembic's paths cannot have."""
    given: list[str] = []
    for number, name in enumerate(names):
        plain = name.replace("/", "_") or f"material_{number}"
        while plain in given:
            plain = f"{plain}_{number}"
        given.append(plain)
    return given


def _integers(values: np.ndarray) -> Any:
    import imath

    return imath.IntArrayFromBuffer(np.ascontiguousarray(values.reshape(-1), np.int32))


def _indices(values: np.ndarray) -> Any:
    import imath

    return imath.UnsignedIntArray(imath.DoubleArrayFromBuffer(np.ascontiguousarray(values.reshape(-1), np.float64)))
