"""What a pull must do to a grown tree's mesh: bones meet at their joints, and what they carry keeps its shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dynamictree.devoxelize.shares import voxel_shares
from dynamictree.mesh import TriangleMesh, connected_parts, edges_of, part_bounds
from dynamictree.modal.bone_attachment import STIFF_VOXELS, attach_mesh
from dynamictree.modal.bones import bones_of
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.locality import default_falloff_m
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import modal_system
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.modal.trees import fork

NUM_PULLS = 12
PULL = 0.1  # of the height


@pytest.fixture(scope="module")
def pulled():
    """A grown tree, its mesh, and where the vertices and the places where parts hang are under each pull."""
    sample = make_sample(13, "round-broadleaf")
    _, spectrum = voxel_spectrum(sample)
    tree, mesh = InteractiveTree(modal_system(spectrum)), sample.mesh
    ties, voxel_m = voxel_shares(spectrum.grid, mesh), spectrum.grid.voxel_size_m
    carried = attach_mesh(tree.bones, mesh, ties, voxel_size_m=voxel_m)
    rng = np.random.default_rng(0)
    moved = []
    for row in rng.choice(np.flatnonzero(tree.bones.bone_of_voxel), NUM_PULLS, replace=False):
        direction = rng.normal(size=3)
        x, y, z = (PULL * tree.system.height_m * direction / np.linalg.norm(direction)).tolist()
        drag = Drag(at=contact_at_voxel(spectrum.grid, int(row)), displacement_m=(x, y, z))
        groups = group_forces([drag], falloff_m=default_falloff_m(tree.system))
        answer = respond(tree.system, groups, dt_s=1 / 60, num_frames=1, start="held", bent=tree)
        moved.append(next(tree.bent(answer, mesh.vertices, carried)))
    return mesh, ties, voxel_m, np.stack(moved)


def stretch(mesh, moved, chosen=slice(None)):
    start, end = edges_of(mesh.faces)[chosen].T
    rest = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    now = np.linalg.norm((mesh.vertices + moved)[start] - (mesh.vertices + moved)[end], axis=1)
    return np.abs(now / rest - 1)[rest > 1e-3]


def test_bones_meet_at_the_joints_between_them():
    spectrum, parts = fork(fineness=3)
    bones, voxel_m = bones_of(modal_system(spectrum)), spectrum.grid.voxel_size_m
    for part in ("stem", "right", "left"):
        rows = parts[part]
        bone = bones.bone_of_voxel[rows]
        changes = np.flatnonzero((bone[1:] != bone[:-1]) & (bones.parent[bone[1:]] == bone[:-1])) + 1
        assert len(changes) >= 3
        gaps = np.linalg.norm(spectrum.grid.centres_m[rows[changes]] - bones.joint_m[bone[changes]], axis=1)
        assert gaps.max() < 2 * voxel_m


def test_edges_hardly_stretch(pulled):
    mesh, _, _, moved = pulled
    p99 = [np.percentile(stretch(mesh, frame), 99) for frame in moved]
    assert np.median(p99) < 0.005
    assert max(p99) < 0.02


def test_leaves_and_twigs_keep_their_shape(pulled):
    mesh, _, voxel_m, moved = pulled
    part = connected_parts(mesh.faces, mesh.num_vertices)
    low, high = part_bounds(part, mesh.vertices)
    small = (high - low).max(axis=1) < STIFF_VOXELS * voxel_m
    inside = small[part[edges_of(mesh.faces)[:, 0]]]
    assert 0.1 < inside.mean() < 1
    assert max(stretch(mesh, frame, inside).max() for frame in moved) < 1e-3


def test_what_hangs_on_a_branch_stays_on_it(pulled):
    _, ties, voxel_m, moved = pulled
    at = ties.attachments
    vertex = np.zeros(len(at.part), np.int64)
    vertex[ties.welded] = np.arange(len(ties.welded))
    places = np.einsum("bsi,tbsic->tbsc", at.weights, moved[:, vertex[at.corners]])
    gaps = np.linalg.norm(places[:, :, 1] - places[:, :, 0], axis=2) / voxel_m  # growth [voxels]
    assert np.percentile(gaps, 99) < 1


def test_a_pulled_vertex_is_where_it_was_asked_to_be():
    """Also one that several bones carry; before, its voxel alone was pulled, and the vertex missed by 16 % and more."""
    sample = make_sample(13, "round-broadleaf")
    _, spectrum = voxel_spectrum(sample, 64)
    tree, mesh = InteractiveTree(modal_system(spectrum)), sample.mesh
    carried = attach_mesh(tree.bones, mesh, voxel_shares(spectrum.grid, mesh), voxel_size_m=spectrum.grid.voxel_size_m)
    rng = np.random.default_rng(1)
    blended = np.flatnonzero((carried.weights > 0.2).sum(axis=1) > 1)
    missed = []
    for vertex in rng.choice(blended, NUM_PULLS, replace=False):
        direction = rng.normal(size=3)
        wanted = PULL * tree.system.height_m * direction / np.linalg.norm(direction)
        at = tree.contact_at_vertex(carried, mesh.vertices, int(vertex))
        groups = group_forces([Drag(at=at, displacement_m=tuple(wanted.tolist()))], falloff_m=0.2 * mesh.height_m)
        answer = respond(tree.system, groups, dt_s=1 / 60, num_frames=1, start="held", bent=tree)
        there = next(tree.bent(answer, mesh.vertices, carried))[vertex]
        np.testing.assert_allclose(there, answer.reached[0].reached_m, atol=1e-4)
        if answer.reached[0].beyond_m == 0:
            missed.append(np.linalg.norm(there - wanted) / np.linalg.norm(wanted))
    assert len(missed) > NUM_PULLS / 3
    assert np.median(missed) < 0.01


def test_a_trunk_of_short_pieces_bends_as_one():
    """Palms are often modelled so: rings, each put over the end of the one below."""
    sample = make_sample(12, "palm")
    mesh, source, ends = with_trunk_of_rings(sample.mesh)
    of_vertex = {name: getattr(sample, name)[source] for name in ("part", "node", "coefficients")}
    _, spectrum = voxel_spectrum(replace(sample, mesh=mesh, **of_vertex))
    tree, voxel_m = InteractiveTree(modal_system(spectrum)), spectrum.grid.voxel_size_m
    carried = attach_mesh(tree.bones, mesh, voxel_shares(spectrum.grid, mesh), voxel_size_m=voxel_m)
    top = int(spectrum.grid.centres_m[:, 2].argmax())
    drag = Drag(at=contact_at_voxel(spectrum.grid, top), displacement_m=(0.25 * tree.system.height_m, 0.0, 0.0))
    groups = group_forces([drag], falloff_m=default_falloff_m(tree.system))
    answer = respond(tree.system, groups, dt_s=1 / 60, num_frames=1, start="held", bent=tree)
    moved = next(tree.bent(answer, mesh.vertices, carried))
    lower, upper = moved[ends].mean(axis=2).transpose(1, 0, 2)  # the ends of all rings
    assert np.linalg.norm(upper, axis=1).max() > 10 * voxel_m
    assert np.linalg.norm(lower[1:] - upper[:-1], axis=1).max() < voxel_m


def with_trunk_of_rings(mesh, num_rings=18, num_sides=7):
    """Tapering tubes in place of the largest part; whose motion each vertex has; rows of the rings' ends [R, 2, S]."""
    part = connected_parts(mesh.faces, mesh.num_vertices)
    trunk = np.flatnonzero(part == np.bincount(part[mesh.faces[:, 0]]).argmax())
    place = mesh.vertices[trunk]
    low, high = place[:, 2].min(), place[:, 2].max()
    step = (high - low) / num_rings
    turn = 2 * np.pi * np.arange(num_sides) / num_sides
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(num_sides)], axis=1)
    vertices = []
    for ring in range(num_rings):
        for end in (ring - 0.1, ring + 1.1):
            height = np.clip(low + end * step, low, high)
            near = place[np.abs(place[:, 2] - height) <= np.abs(place[:, 2] - height).min() + 0.5 * step]
            middle = np.array([*near[:, :2].mean(axis=0), height])
            vertices.append(middle + 0.05 * (high - low) * (1 - 0.5 * ring / num_rings) * circle)
    first = np.arange(num_sides)
    one = np.concatenate([np.stack([first, np.roll(first, -1), first + num_sides], axis=1)] * 2)
    one[num_sides:] = np.stack([np.roll(first, -1), np.roll(first, -1) + num_sides, first + num_sides], axis=1)
    added = np.concatenate(vertices).astype(np.float32)
    crown = np.flatnonzero(part != part[trunk[0]])
    new_row = np.full(mesh.num_vertices, -1)
    new_row[crown] = np.arange(len(crown))
    rings = len(crown) + (2 * num_sides * np.arange(num_rings)[:, None, None] + one).reshape(-1, 3)
    leaves = new_row[mesh.faces[(new_row[mesh.faces] >= 0).all(axis=1)]]
    nearest = trunk[cKDTree(place).query(added)[1]]
    ringed = TriangleMesh(
        vertices=np.concatenate([mesh.vertices[crown], added]), faces=np.concatenate([leaves, rings]).astype(np.int32)
    )
    ends = len(crown) + np.arange(len(added)).reshape(num_rings, 2, num_sides)
    return ringed, np.concatenate([crown, nearest]), ends
