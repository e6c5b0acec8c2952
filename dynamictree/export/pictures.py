"""Pictures and films of a moving mesh or splat."""

from collections.abc import Iterator
from typing import BinaryIO

from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.export.splat_scene import SplatScene
from dynamictree.export.splat_sheet import splat_sheet
from dynamictree.gaussian.animate import iter_poses
from dynamictree.gaussian.binding import Binding
from dynamictree.render import Backdrop, Renderer, RenderSettings, draw_contact_sheet, write_png
from dynamictree.render.camera import Camera, cameras_of, points_in_view
from dynamictree.render.video import Picture


def write_sheet(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write a PNG with one picture, the amplitude of the sway in colours, a space-time slice and a row of frames."""
    if tree.captured and tree.binding is not None:
        sheet = splat_sheet(tree, tree.binding, report)
    else:
        sheet = draw_contact_sheet(tree.mesh, tree.coefficients, num_frames=tree.spectrum.num_frames)
    write_png(sheet, stream)


def draw(tree: MovingTree, report: Report) -> Iterator[Picture]:
    """Draw the frames of a film: of the splat where one was captured, else of the mesh."""
    if tree.captured and tree.binding is not None:
        return _draw_splat(tree, tree.binding, report)
    return _draw_mesh(tree, report)


def _draw_mesh(tree: MovingTree, report: Report) -> Iterator[Picture]:
    shot = tree.params.shot
    look = RenderSettings(width=shot.side_px, height=shot.side_px, ground=shot.ground, grey_still=shot.grey_still)
    renderer = Renderer(tree.mesh, look)
    seen = points_in_view(tree.mesh.vertices, ~tree.mesh.still_vertices)
    cameras = cameras_of(shot, tree.mesh.vertices[seen], len(tree.phases))
    for frame, camera in zip(tree.frames(report), cameras, strict=True):
        yield renderer.picture(frame, camera=camera)


def _draw_splat(tree: MovingTree, binding: Binding, report: Report) -> Iterator[Picture]:
    """Draw the Gaussians over a floor with their shadow and a sky."""
    shot, side = tree.params.shot, tree.params.shot.side_px
    scene = SplatScene.of(binding, ground=shot.ground, grey_still=shot.grey_still)
    behind: tuple[Camera, Backdrop] | None = None
    poses = iter_poses(scene.binding, tree.frames(report))
    for pose, camera in zip(poses, cameras_of(shot, scene.bounds, len(tree.phases)), strict=True):
        if behind is None or behind[0] is not camera:
            behind = (camera, scene.backdrop(camera, (side, side)))
        yield scene.picture(camera, (side, side), pose, behind[1])
