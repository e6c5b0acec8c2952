"""Parts that a request names, or puts into a box, stand still or move, whatever was detected."""

from functools import cache
from io import BytesIO

import numpy as np
import pytest
import trimesh

from dynamictree.errors import InputError
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.tensors.bundle import read_mesh_bundle, write_bundle
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.choice import choose_gaussians, with_choice
from dynamictree.requests import CloudParams, Reading
from tests.formats.meshes import written


def scene() -> bytes:
    """A stem, a lantern on it and a flowerpot below, as a GLB whose nodes are named."""
    result = trimesh.Scene()
    parts = [("world", "Stem", 0.2, 2.0), ("Lamp", "Cylinder.001", 0.4, 1.5), ("world", "FlowerPot", 0.5, 0.0)]
    for parent, name, size, height in parts:
        if parent not in result.graph.nodes:
            result.graph.update(frame_from="world", frame_to=parent)
        box = trimesh.creation.box([size, size if name != "Stem" else 4, size]).apply_translation([0, height, 0])
        result.add_geometry(box, node_name=name, geom_name=f"mesh {name}", parent_node_name=parent)
    return bytes(result.export(file_type="glb"))


@cache
def read() -> TriangleMesh:
    """As a worker has it: through the bundle."""
    return read_mesh_bundle(BytesIO(written(write_bundle, read_mesh(BytesIO(scene()), file_type="glb"))))


def still_names(mesh: TriangleMesh, **options: object) -> set[str]:
    """Which nodes stand still."""
    chosen = with_choice(mesh, CloudParams.model_validate(options))
    still = np.zeros(mesh.num_faces, np.bool_) if chosen.still_faces is None else chosen.still_faces
    return {mesh.parts.names[part].rpartition("/")[2] for part in np.unique(mesh.parts.of_face[still])}


def test_nodes_are_named_with_those_above_them_and_give_reasons() -> None:
    mesh = read()
    assert {"Lamp/Cylinder.001", "FlowerPot"} <= {name.removeprefix("world/") for name in mesh.parts.names}
    assert [(part.name.removeprefix("world/"), part.why) for part in mesh.parts.still] == [("FlowerPot", "its name")]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, {"FlowerPot"}),
        ({"still": ("lamp",)}, {"FlowerPot", "Cylinder.001"}),
        ({"still": ("Cyl*",)}, {"FlowerPot", "Cylinder.001"}),
        ({"moving": ("flower?ot",)}, set()),
        ({"moving": ("*",), "still": ("Stem",)}, {"Stem"}),
        ({"still_box_m": ((-1, -1, 1.2), (1, 1, 1.8))}, {"FlowerPot", "Cylinder.001", "Stem"}),
        ({"moving_box_m": ((-1, -1, -1), (1, 1, 0.6))}, set()),
        ({"moving": ("*",), "box_m": ((-9, -9, 1.2), (9, 9, 9))}, {"FlowerPot", "Stem"}),
    ],
)
def test_what_a_request_says_goes_before_what_was_detected(options: dict, expected: set[str]) -> None:
    assert still_names(read(), **options) == expected


def test_names_that_fit_nothing_or_leave_nothing_to_move_are_refused() -> None:
    with pytest.raises(InputError, match=r"still names 'vase', and no part is called so; there are .*Stem.*FlowerPot"):
        with_choice(read(), CloudParams(still=("vase",)))
    with pytest.raises(InputError, match="leave no face that moves"):
        with_choice(read(), CloudParams(still=("*",)))


def test_groups_of_an_obj_have_names() -> None:
    square = "v 0 0 {0}\nv 1 0 {0}\nv 1 1 {0}\nv 0 1 {0}\n"
    text = square.format(0) + "f 1 2 3 4\no Bush\n" + square.format(1) + "f 5 6 7 8\ng Basket\nf 5 7 8\n"
    mesh = read_mesh(BytesIO(text.encode()), file_type="obj", reading=Reading(up_axis="+Z", unit_m=1.0))
    assert [mesh.parts.names[part] for part in mesh.parts.of_face] == ["", "", "Bush", "Bush", "Basket"]
    chosen = with_choice(mesh, CloudParams(still=("basket",), moving=("Bush",)))
    assert chosen.still_faces[-1]
    assert not chosen.still_faces[2:4].any()


def test_detected_parts_of_a_cloud_are_named_and_boxes_go_before_them() -> None:
    means = np.float32([[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]])
    part_of = np.array([1, 2, 0, 0], np.uint8)

    def moving(**options: object) -> list[int]:
        rows = choose_gaussians(means, part_of == 0, ["ground", "pot"], part_of, CloudParams.model_validate(options))
        return np.flatnonzero(rows).tolist()

    low = ((-1, -1, 0.5), (1, 1, 2.5))
    assert moving() == [2, 3]
    assert moving(moving=("pot",)) == [1, 2, 3]
    assert moving(moving_box_m=low) == [1, 2, 3]
    assert moving(still_box_m=low) == [3]
    assert moving(moving=("*",), box_m=low) == [1, 2]
    with pytest.raises(InputError, match="there are ground, pot"):
        moving(still=("table",))
    with pytest.raises(InputError, match="no Gaussian moves"):
        moving(still_box_m=((-1, -1, 1.5), (1, 1, 9)))
