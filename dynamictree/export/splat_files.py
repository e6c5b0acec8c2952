"""Writers of the products that show a moving splat."""

from typing import BinaryIO

from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.formats.motion.html import write_splat_html
from dynamictree.formats.motion.splat_sequence import iter_splat_files
from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.formats.tensors.animated_splat import write_animated_splat
from dynamictree.gaussian.animate import AnimatedSplat, iter_poses


def write_splat_sequence(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write a splat PLY file per frame, in a ZIP."""
    assert tree.binding is not None
    frames, turns = tree.frames(report), tree.leaf_turns()
    write_stored_zip(stream, iter_splat_files(tree.binding, frames, turns, first_number=tree.params.first_frame))


def write_usd_splat(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write USD of a Gaussian splat with a time sample per frame."""
    from dynamictree.formats.motion.usd_splat import write_splat_usdz

    assert tree.binding is not None
    poses = iter_poses(tree.binding, tree.frames(report), tree.leaf_turns())
    write_splat_usdz(tree.binding.cloud, poses, stream, fps=tree.params.fps)


def write_compact_splat(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write the splat at rest, its binding and the spectrum; a player computes the frames."""
    write_animated_splat(_animated(tree), stream)


def write_splat_page(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write an HTML file that plays the splat's loop from disk, without a server.

    Raises:
        InputError: the splat is too large for a page.
    """
    write_splat_html(_animated(tree), stream, title="A tree in the wind")


def _animated(tree: MovingTree) -> AnimatedSplat:
    assert tree.binding is not None
    return AnimatedSplat(
        binding=tree.binding,
        coefficients=tree.coefficients,
        num_frames=tree.spectrum.num_frames,
        fps=tree.loop_fps,
        flutter=tree.leaves,
    )
