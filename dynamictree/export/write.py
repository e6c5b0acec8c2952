"""Write the requested products of one motion into a folder."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import numpy as np

from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.export.pictures import draw
from dynamictree.export.size import min_sequence_bytes
from dynamictree.export.table import PRODUCTS, require_available
from dynamictree.formats.tensors.rig import read_rig, write_rig
from dynamictree.gaussian.animate import reduced_splat
from dynamictree.gaussian.binding import Binding, bind
from dynamictree.gaussian.leaves import flutter_leaves
from dynamictree.mesh import AnyMesh, TriangleMesh, triangle_mesh
from dynamictree.plant.capture import Capture, moving_part
from dynamictree.requests import CloudParams, ExportParams, Format
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum

RIG_SHARE = 0.5
"""Share of the progress for the rig, which comes before the first file."""
OnFacts = Callable[[Format, Facts], None]
"""Receives a format that is not exact, and the error of its file against the motion."""
Result = Literal["rig", "reconstruction"]
"""Results that are stored: the rig of a tree, and the reconstruction from photos."""
Recall = Callable[[Result, Callable[[Path], None]], Path]
"""Returns the file of a result; if there is none, calls the function that writes it to a path."""


def write_products(
    mesh: AnyMesh,
    spectrum: SparseVoxelSpectrum,
    params: ExportParams,
    folder: Path,
    on_progress: Report | None = None,
    *,
    capture: Capture | None = None,
    choice: CloudParams | None = None,
    on_facts: OnFacts | None = None,
    recall: Recall | None = None,
) -> dict[Format, Path]:
    """Write the requested products of one motion into a folder; return their paths by format.

    If a capture is given, pictures and splats show it; else splats are made from the mesh.
    `on_progress` receives the completed share in [0, 1]; its exceptions propagate. `recall` returns stored results of
    other products of the same motion.

    Raises:
        InputError: the frames do not make a loop, though `loop` is set; the capture is not where the mesh is;
            a sequence of splats would be too large; or a format's library is not installed.
    """
    mesh = triangle_mesh(mesh)
    formats = params.chosen_formats(cloud=capture is not None)
    require_available(formats)
    num_frames = params.count_frames(spectrum.period_s)
    binding = _binding(mesh, formats, capture, choice)
    cloud = (0, 0) if binding is None else (binding.cloud.num_gaussians, binding.cloud.sh_degree)
    min_sequence_bytes(formats, num_frames, params, mesh=(mesh.num_vertices, mesh.num_faces), cloud=cloud)
    report = on_progress or (lambda done: None)
    report(0.0)
    rig = stored_rig(mesh, spectrum, recall, lambda done: report(RIG_SHARE * done))
    report(RIG_SHARE)
    leaves = None
    if binding is not None and capture is not None:
        binding, leaves = flutter_leaves(binding, rig, spectrum, params.flutter)
    tree = MovingTree(
        mesh=mesh,
        spectrum=spectrum,
        rig=rig,
        params=params,
        binding=None if binding is None else reduced_splat(binding, share=params.share, sh_degree=params.sh_degree),
        captured=capture is not None,
        leaves=leaves,
    )
    paths = {name: folder / PRODUCTS[name].file_name for name in formats}
    _write(tree, paths, lambda done: report(RIG_SHARE + (1 - RIG_SHARE) * done), on_facts or (lambda name, facts: None))
    return paths


def _binding(
    mesh: TriangleMesh, formats: Sequence[Format], capture: Capture | None, choice: CloudParams | None
) -> Binding | None:
    """Bind the capture to the mesh; without one, make a splat of the mesh if a product needs it, with a fixed seed."""
    from dynamictree.gaussian.from_mesh import splats_of_mesh

    if capture is not None:
        return bind(capture.cloud, mesh, mask=moving_part(capture, choice))
    if all(PRODUCTS[name].shows != "splat" for name in formats):
        return None
    return splats_of_mesh(mesh, rng=np.random.default_rng(0)).binding


def _write(tree: MovingTree, paths: dict[Format, Path], on_progress: Report, on_facts: OnFacts) -> None:
    """Write files first, then the products that are made of pictures."""
    films = {}
    done = 0

    def report(share: float) -> None:
        on_progress((done + share) / len(paths))

    for name, path in paths.items():
        product = PRODUCTS[name]
        if product.write is None:
            films[name] = path
            continue
        with path.open("wb") as stream:
            facts = product.write(tree, stream, report)
        if facts:
            on_facts(name, facts)
        done += 1
        report(0.0)
    if films:
        _write_films(tree, films, report)
        on_progress(1.0)


def _write_films(tree: MovingTree, paths: dict[Format, Path], report: Report) -> None:
    """Write the products made of pictures, which are drawn once; a single product is written while they are drawn."""
    from dynamictree.render.video import stored_frames

    drawn = draw(tree, report)
    with stored_frames(drawn) if len(paths) > 1 else nullcontext(drawn) as film:
        for name, path in paths.items():
            write_film = PRODUCTS[name].write_film
            assert write_film is not None
            with path.open("wb") as stream:
                write_film(film, stream, tree.params.fps)


def stored_rig(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum, recall: Recall | None, report: Report) -> Rig:
    """Return the rig, from the file of an earlier product of the same motion if there is one."""
    if recall is None:
        return rig_of(mesh, spectrum, report)

    def make(path: Path) -> None:
        with path.open("xb") as stream:
            write_rig(rig_of(mesh, spectrum, report), stream)

    with recall("rig", make).open("rb") as stream:
        return read_rig(stream)
