"""OBJ and MTL as many programs write them."""

import io

import numpy as np
import pytest

from dynamictree.errors import MeshError
from dynamictree.formats.mesh.obj import read_obj
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import image_bytes

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 0 2\nv 0 0 2\n"
CORNERS = [[0, 0, 0], [1, 0, 0], [1, 0, 2], [0, 0, 2]]


def read(text: str, **files: bytes) -> TriangleMesh:
    return read_obj(text.encode(), companions={name.replace("__", "."): content for name, content in files.items()})


@pytest.mark.parametrize(
    "text",
    [
        SQUARE + "\n\nf\nf 1 2 3 4\n",
        SQUARE.replace(" ", "\t") + "f\t1\t2\t3\t4",
        "\ufeff# made by\r\n" + SQUARE.replace("\n", "\r\n") + "f 1 2 \\\r\n3 4\r\n",
        SQUARE.replace("\n", "\r") + "f 1 2 3 4\r",  # line ends of a Mac before 2001
        SQUARE + "f 1 2 \\ \n 3 4 # a comment\n",
        SQUARE + "f -4 -3 -2 -1\nv 9 9 9\n",
        SQUARE + "o b\nf -4// -3// -2// -1//\n",
        SQUARE + "vt 0 0 0\nvt 1 0 0\nf 1/1/ 2/2/ 3/1/ 4/2/\n",
        SQUARE + "vn 0 1 0\nf 1//1 2//1 3//9 4\n",  # a normal that is not there, a corner without one
        SQUARE + "p 1\nl 1 2\nf 1 2\ns 1\nfo 1 2 3 4\ncstype bezier\ncurv 0 1 1 2\nend\n",
        SQUARE.replace("v 1 0 2", "v 1,0 0,0 2,0") + "f 1 2 3 4",
        SQUARE.replace("v 1 0 0", "v 1 0 0 0.5 0.5 0.5").replace("v 1 0 2", "v 1 0 2 1.0") + "f 1 2 3 4\n",
        SQUARE + "mtllib\ng\nf 1 2 3 4\n",
    ],
)
def test_a_square_is_read_however_it_is_written(text: str) -> None:
    mesh = read(text)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], np.array(CORNERS, np.float32)[[[0, 1, 2], [0, 2, 3]]])


@pytest.mark.parametrize(
    ("behind", "color"),
    [
        (" 110 75 45", [110, 75, 45]),
        (" 0.4 0.2 1", [102, 51, 255]),
        (" 1 110 75 45", [110, 75, 45]),  # a weight of 1 first
        (" 110 75 45 255", [110, 75, 45]),
        ("\t0.4\t0.2\t0", [102, 51, 0]),
    ],
)
def test_colours_behind_the_position(behind: str, color: list[int]) -> None:
    mesh = read(SQUARE.replace("\n", behind + "\n") + "f 1 2 3\n")
    assert mesh.look.vertex_colors[0].tolist() == [*color, 255]


def test_vertices_without_a_colour_are_white_beside_others() -> None:
    mesh = read(SQUARE.replace("v 1 0 0", "v 1 0 0 255 0 0") + "f 1 2 3 4\n")
    assert mesh.look.vertex_colors[:2].tolist() == [[255, 255, 255, 255], [255, 0, 0, 255]]


@pytest.mark.parametrize(
    ("library", "mtl"),
    [
        ("tree.mtl", "newmtl bark\nmap_Kd -s 1 2 1 -clamp on My Textures\\bark oak.png"),
        ("tree.mtl", "newmtl\tbark\n\tmap_Kd\t-blendu off\t-o 0.5 0 bark oak.png"),
        ("tree.mtl", "newmtl BARK\nMAP_KD -mm 0 1 -bm 0.2 -imfchan l bark oak.png\nKd xyz 1 2 3"),
        ("tree.mtl", 'newmtl bark\nmap_Kd "C:\\art\\Bark Oak.PNG"'),
        ("./TREE.MTL", "newmtl bark\nmap_Kd ../textures/bark%20oak.png"),
        ("other.mtl tree.mtl", "newmtl bark\nmap_Kd bark oak.png"),
        ("before it was renamed.mtl", "newmtl bark\nmap_Kd bark oak.png"),
    ],
)
def test_a_texture_that_was_sent_is_used(library: str, mtl: str) -> None:
    text = f"mtllib {library}\n{SQUARE}vt 0 0\nusemtl bark\nf 1/1 2/1 3/1\n"
    picture = image_bytes()
    mesh = read_obj(text.encode(), companions={"tree.mtl": mtl.encode(), "my textures/bark oak.png": picture})
    assert (mesh.look.materials[0].texture_png, mesh.warnings) == (picture, ())


def test_a_library_of_another_model_is_not_taken() -> None:
    (warning,) = read(f"mtllib mine.mtl\n{SQUARE}usemtl bark\nf 1 2 3\n", other__mtl=b"newmtl leaf\n").warnings
    assert warning.code == "material-library-missing"


def test_colours_of_materials_may_be_short_or_spectral() -> None:
    text = f"mtllib a.mtl\n{SQUARE}usemtl grey\nf 1 2 3\nusemtl curve\nf 1 3 4\n"
    mesh = read(text, a__mtl=b"newmtl grey\nKd 0.25\nd -halo 0.5\nnewmtl curve\nKd spectral a.rfl\nTr 0.25\n")
    assert [material.base_color for material in mesh.look.materials] == [(0.25, 0.25, 0.25, 0.5), (0.8, 0.8, 0.8, 0.75)]


def test_more_materials_than_a_tree_can_have_are_refused() -> None:
    faces = "".join(f"usemtl m{number}\nf 1 2 3\n" for number in range(10_001))
    with pytest.raises(MeshError, match="10,001 materials"):
        read(f"mtllib none.mtl\n{SQUARE}{faces}")


@pytest.mark.parametrize("file_type", ["obj", "ply", "stl", "off"])
def test_map_coordinates_are_shifted_before_they_are_rounded(file_type: str) -> None:
    foot = np.array([665_187.4375, 5_648_349.0625, 251.03125])
    places = foot + np.array([[0, 0, 0], [0.001953125, 0, 0], [0, 0, 5.625]])
    rows = [f"{x!r} {y!r} {z!r}" for x, y, z in places.tolist()]
    content = {
        "obj": "".join(f"v {row}\n" for row in rows) + "f 1 2 3\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n" + "\n".join(rows) + "\n3 0 1 2\n",
        "stl": "solid t\nfacet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {row}\n" for row in rows)
        + "endloop\nendfacet\nendsolid t\n",
        "off": "OFF\n3 1 0\n" + "\n".join(rows) + "\n3 0 1 2\n",
    }[file_type]
    mesh = read_mesh(io.BytesIO(content.encode()), file_type=file_type, reading=Reading(up_axis="+Z", unit_m=1))
    assert mesh.source.offset == (665_187, 5_648_349, 253)
    moved = np.sort(mesh.vertices.astype(np.float64) + mesh.source.offset, axis=0)
    np.testing.assert_allclose(moved, np.sort(places, axis=0), atol=1e-6)
    assert [warning.code for warning in mesh.warnings if "665187, 5648349" in warning.message] == ["moved-to-origin"]
