"""PLY files that name their up axis and unit are read back as they were written."""

import io
from dataclasses import replace

import numpy as np
import pytest

from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.ply_table import read_header
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import written
from tests.formats.test_cloud_round_trips import make_cloud


def lying_mesh() -> TriangleMesh:
    """As a fallen trunk: wider than high, so that the guess would turn it."""
    rng = np.random.default_rng(0)
    vertices = (rng.uniform(0, 1, (90, 3)) * [0.02, 3, 0.03]).astype(np.float32)
    return TriangleMesh(vertices=vertices, faces=np.arange(90, dtype=np.int32).reshape(30, 3))


def test_our_own_mesh_is_read_back_as_it_stood():
    mesh = lying_mesh()
    content = written(write_ply, mesh)
    read = read_mesh(io.BytesIO(content), file_type="ply")
    assert np.array_equal(read.vertices, mesh.vertices)
    assert (read.source.up_axis, read.source.scale) == ("+Z", 1.0)
    plain = b"".join(line for line in content.splitlines(keepends=True) if not line.startswith(b"comment"))
    assert not np.allclose(read_mesh(io.BytesIO(plain), file_type="ply").vertices, mesh.vertices)
    stated = read_mesh(io.BytesIO(content), file_type="ply", reading=Reading(up_axis="+Y", unit_m=0.5))
    assert (stated.source.up_axis, stated.source.scale) == ("+Y", 0.5), "what the caller says counts more"


@pytest.mark.parametrize(("up_axis", "scale"), [("-Y", 1.0), ("+Z", 0.01), ("+Y", 2.5)])
def test_our_own_splat_is_read_back_as_it_stood(up_axis, scale):
    cloud = make_cloud(np.random.default_rng(0), 9)
    content = written(write_gaussian_ply, replace(cloud, source=replace(cloud.source, up_axis=up_axis, scale=scale)))
    read = read_cloud(io.BytesIO(content), file_type="ply")
    assert np.allclose(read.means, cloud.means, atol=1e-5)
    assert (read.source.up_axis, read.source.scale) == (up_axis, scale)


@pytest.mark.parametrize("comment", ["up_axis up", "unit_m -1", "unit_m nan", "unit_m one", "up_axis +Z +Y"])
def test_comments_that_mean_something_else_are_ignored(comment):
    header = read_header(
        io.BytesIO(f"ply\nformat ascii 1.0\ncomment {comment}\nelement vertex 0\nend_header\n".encode())
    )
    assert header.up_axis is None
    assert header.unit_m is None


KINDS = (("f_dc", 3), ("scale", 3), ("rot", 4))


@pytest.mark.parametrize(("comment", "up_axis"), [("Vertical Axis: z", "+Z"), ("Vertical axis: y", "-Y")])
def test_a_splat_of_nerfstudio_says_its_axis_and_one_of_brush_does_not(comment, up_axis):
    names = [*"xyz", "opacity", *(f"{kind}_{number}" for kind, count in KINDS for number in range(count))]
    properties = "".join(f"property float {name}\n" for name in names)
    header = f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex 9\n{properties}end_header\n"
    rows = np.random.default_rng(0).normal(size=(9, len(names))).astype("<f4")
    read = read_cloud(io.BytesIO(header.encode() + rows.tobytes()), file_type="ply")
    assert read.source.up_axis == up_axis
