"""`dynamictree interact`: push a tree and write how it swings."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from safetensors.numpy import save

from dynamictree.commands.input_files import load_mesh
from dynamictree.commands.options import OutputFolder
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.errors import InputError
from dynamictree.files import atomic_folder, open_input
from dynamictree.formats.mesh.ply_writer import iter_ply_files
from dynamictree.formats.stored_zip import write_stored_zip
from dynamictree.formats.tensors.motion import write_motion
from dynamictree.formats.tensors.spectrum import read_spectrum
from dynamictree.modal.force import Contact, Drag, Force, Impulse, WindField, contact_at_point, contact_at_voxel
from dynamictree.modal.interactive_tree import Answer, InteractiveTree
from dynamictree.modal.response import answer_tensors, group_forces, respond
from dynamictree.modal.system import ModalSystem, chosen_falloff_m, modal_system
from dynamictree.requests import InteractParams, Reading
from dynamictree.rig.rig import rig_of

FORMATS = ("modal", "motion", "ply")
FILE_NAMES = {"modal": "modal.safetensors", "motion": "motion.safetensors", "ply": "frames-ply.zip"}

Vector = tuple[float, float, float]
"""Three numbers after an option. In help texts units are escaped, since rich would read `[m]` as markup."""


@with_request_options
def interact(
    spectrum: Annotated[Path, typer.Argument(help="A *.spectrum.safetensors that `diffuse` or `animate` wrote.")],
    output: OutputFolder,
    reading: Reading,
    params: InteractParams,
    mesh: Annotated[Path | None, typer.Option(help="Mesh of the spectrum, which motion and ply need.")] = None,
    formats: Annotated[
        str, typer.Option("--format", help="Formats, separated by commas: modal (coordinates), motion, ply.")
    ] = "modal",
    impulse: Annotated[Vector | None, typer.Option(metavar="X Y Z", help="Impulse at the place \\[N s].")] = None,
    force: Annotated[Vector | None, typer.Option(metavar="X Y Z", help="Force at the place \\[N].")] = None,
    displacement: Annotated[
        Vector | None, typer.Option(metavar="X Y Z", help="Displacement at which a pull holds the place \\[m].")
    ] = None,
    wind: Annotated[Vector | None, typer.Option(metavar="X Y Z", help="Wind over the whole tree \\[m/s].")] = None,
    point: Annotated[
        Vector | None, typer.Option(metavar="X Y Z", help="Place of the force \\[m], +Z up; by default the top.")
    ] = None,
    voxel: Annotated[int | None, typer.Option(min=0, help="Place as a row of the spectrum's voxels.")] = None,
    radius: Annotated[float, typer.Option(min=0, max=1000, help="Radius over which the force is spread \\[m].")] = 0.0,
    start: Annotated[float, typer.Option(min=0, max=1e6, help="Start of the force \\[s].")] = 0.0,
    duration: Annotated[
        float | None,
        typer.Option(min=0, max=1e6, help="Duration \\[s]; by default one frame for an impulse, else to the end."),
    ] = None,
    held: Annotated[bool, typer.Option(help="Start in equilibrium with the pull, and release it.")] = False,
    frames: Annotated[int, typer.Option(min=1, max=6000, help="Number of frames.")] = 120,
    fps: Annotated[float, typer.Option(min=1, max=1000, help="Frames per second; each is one step.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Compute the response of a tree to forces: spectrum + forces → modal coordinates, moving mesh.

    --displacement needs --mesh, in which the joints are found. With it, forces act at the vertex nearest to --point.
    """
    if displacement is not None and mesh is None:
        raise InputError(
            "--displacement bends joints, which are found in the mesh; name it with --mesh, or give --force"
        )
    wanted = _formats(formats, has_mesh=mesh is not None)
    with open_input(spectrum) as stream:
        sway = read_spectrum(stream)
        system = modal_system(
            sway,
            mass_kg=params.mass_kg,
            damping_ratio=params.damping_ratio,
            frequency_hz=params.frequency_hz,
            foliage=params.foliage,
        )
    source = None if mesh is None else load_mesh(mesh, reading)
    rig = None if source is None else rig_of(source, sway)
    tree = InteractiveTree(system, rig, source)
    at = _contact(system, point, voxel, radius)
    if source is not None and point is not None:
        nearest = int(np.linalg.norm(source.vertices - np.asarray(point), axis=1).argmin())
        at = tree.contact_at_vertex(source.vertices, nearest, radius_m=radius)
    forces = _forces(at, impulse=impulse, force=force, displacement=displacement, wind=wind, times=(start, duration))
    groups = group_forces(forces, falloff_m=chosen_falloff_m(system, params))
    answer = respond(
        system,
        groups,
        dt_s=1 / fps,
        num_frames=frames,
        integrator=params.integrator,
        start="held" if held else "rest",
        tree=tree,
    )
    files = _write(answer, tree, output, wanted=wanted, fps=fps)
    facts = {
        "files": [str(path) for path in files],
        "num_frames": frames,
        "groups": len(groups),
        "mass_kg": system.mass_kg,
        "reached_m": [[round(float(x), 4) for x in one.reached_m] for one in answer.reached],
        "place_m": [round(float(x), 4) for x in (at.grip.point_m if at.grip else system.grid.centres_m[at.rows[0]])],
    }
    show_result(facts, as_json=as_json)


def _formats(formats: str, *, has_mesh: bool) -> tuple[str, ...]:
    wanted = tuple(name.strip() for name in formats.split(","))
    unknown = [name for name in wanted if name not in FORMATS]
    if unknown:
        raise InputError(f"there is no format {unknown[0]!r}; choose from {', '.join(FORMATS)}")
    if not has_mesh and set(wanted) != {"modal"}:
        raise InputError(f"the formats {formats} move a mesh; name it with --mesh, or ask for modal alone")
    return wanted


def _contact(system: ModalSystem, point: Vector | None, voxel: int | None, radius_m: float) -> Contact:
    if point is not None and voxel is not None:
        raise InputError("the place is given twice; give --point or --voxel")
    if point is None:
        row = int(system.grid.coords[:, 2].argmax()) if voxel is None else voxel
        at = contact_at_voxel(system.grid, row)
        if radius_m == 0:
            return at
        x, y, z = system.grid.centres_m[row].tolist()
        point = (x, y, z)
    return contact_at_point(system.grid, point, radius_m=radius_m)


def _forces(
    at: Contact,
    *,
    impulse: Vector | None,
    force: Vector | None,
    displacement: Vector | None,
    wind: Vector | None,
    times: tuple[float, float | None],
) -> list[Force]:
    start_s, duration_s = times
    forces: list[Force] = []
    if impulse is not None:
        forces.append(Impulse(at=at, impulse_n_s=impulse, start_s=start_s, duration_s=duration_s or 0.0))
    if force is not None:
        forces.append(Drag(at=at, force_n=force, start_s=start_s, duration_s=duration_s))
    if displacement is not None:
        forces.append(Drag(at=at, displacement_m=displacement, start_s=start_s, duration_s=duration_s))
    if wind is not None:
        forces.append(WindField(velocity_m_s=np.array([wind]), start_s=start_s, duration_s=duration_s))
    if not forces:
        raise InputError("nothing pushes the tree; give --impulse, --force, --displacement or --wind")
    return forces


def _write(answer: Answer, tree: InteractiveTree, output: Path, *, wanted: tuple[str, ...], fps: float) -> list[Path]:
    with atomic_folder(output) as folder:
        for name in wanted:
            with (folder / FILE_NAMES[name]).open("wb") as stream:
                if name == "modal":  # the same as from /v1/interact
                    stream.write(save(answer_tensors(answer), {"fps": repr(fps)}))
                    continue
                mesh, rig = tree.mesh, tree.rig
                assert mesh is not None
                assert rig is not None
                moved = tree.bent(answer, mesh.vertices, rig.vertices)
                if name == "motion":
                    write_motion(mesh, moved, stream, num_frames=len(answer.q), fps=fps)
                else:
                    write_stored_zip(stream, iter_ply_files(mesh, moved))
    return [output / FILE_NAMES[name] for name in wanted]
