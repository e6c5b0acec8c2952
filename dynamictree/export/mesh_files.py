"""Writers of the products that show a moving mesh."""

import io
from dataclasses import asdict
from typing import BinaryIO

from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.mesh.ply_writer import iter_ply_files
from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.formats.tensors.motion import write_motion


def write_ply_sequence(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write a PLY file per frame, in a ZIP."""
    write_stored_zip(stream, iter_ply_files(tree.mesh, tree.frames(report), first_number=tree.params.first_frame))


def write_displacements(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write the displacement of every vertex at every frame, as safetensors."""
    write_motion(tree.mesh, tree.frames(report), stream, num_frames=len(tree.phases), fps=tree.params.fps)


def write_glb(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Write a GLB with all bones as joints, or only the few that lose the least motion."""
    from dynamictree.formats.gltf.skin import Packing, write_skinned_glb

    skin, summary = tree.skin
    packing = Packing(tree.params.glb_compression == "meshopt", tree.params.glb_textures == "webp")
    return asdict(write_skinned_glb(tree.mesh, skin, summary, stream, fps=tree.loop_fps, packing=packing))


def write_morph_glb(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Write a GLB with two morph targets per frequency of the loop; storms have more frequencies."""
    summary = write_motion_glb(
        tree.mesh, tree.loop, stream, num_frames=tree.spectrum.num_frames, fps=tree.loop_fps, truth=tree.loop_frames
    )
    return asdict(summary)


def write_page(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write an HTML file that plays the loop of the GLB from disk, without a server."""
    from dynamictree.formats.gltf.skin import Packing, write_skinned_glb
    from dynamictree.formats.motion.html import write_html

    glb = io.BytesIO()
    write_skinned_glb(tree.mesh, *tree.skin, glb, fps=tree.loop_fps, packing=Packing(False, False))
    write_html(glb.getvalue(), stream, title="A tree in the wind")


def write_skinned_usdz(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Write USD with the joints and weights of the GLB, in a USDZ package."""
    from dynamictree.formats.motion import usd_skin

    skin, summary = tree.skin
    usd_skin.write_skinned_usdz(tree.mesh, skin, stream, fps=tree.loop_fps)
    return asdict(summary)


def write_usdz(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write USD with a time sample per frame, in a USDZ package."""
    from dynamictree.formats.motion.usd import write_motion_usdz

    write_motion_usdz(tree.mesh, tree.frames(report), stream, fps=tree.params.fps)


def write_alembic(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write Alembic with a sample per frame."""
    from dynamictree.formats.motion.alembic import write_motion_alembic

    write_motion_alembic(tree.mesh, tree.frames(report), stream, fps=tree.params.fps)


def write_vertex_texture(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write a vertex animation texture with its GLB, in a ZIP.

    Raises:
        InputError: the motion does not fit into a texture.
    """
    from dynamictree.formats.gltf.normals import iter_normals
    from dynamictree.formats.motion.vertex_texture import vertex_texture_files

    params = tree.params
    files = vertex_texture_files(
        tree.mesh,
        tree.frames(report),
        num_frames=len(tree.phases),
        fps=params.fps,
        loop=params.loop and params.wind_mode == "loop",
        normals=iter_normals(tree.mesh, tree.frames(report)) if params.normals else None,
    )
    write_stored_zip(stream, files)
