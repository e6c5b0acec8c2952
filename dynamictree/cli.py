"""`dynamictree`: the method's own commands, and by name those that other packages declare.

A command is loaded when it is called: `serve`, `doctor`, … come from the entry-point group `dynamictree.commands`.
"""

import importlib
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import typer
from typer.core import TyperGroup

from dynamictree.errors import DynamicTreeError, InputError

if TYPE_CHECKING:
    from dynamictree.gaussian.capture import Box, Capture
    from dynamictree.mesh import TriangleMesh
    from dynamictree.pipeline import OnStep
    from dynamictree.products import AnimateOptions, Facts

PLUGIN_GROUP = "dynamictree.commands"
OWN_COMMANDS = {
    "dataset": "dynamictree.dataset.commands:app",
    "evaluate": "dynamictree.training.evaluate_command:evaluate",
    "interact": "dynamictree.modal.commands:interact",
    "train": "dynamictree.training.commands:train",
}


class LazyGroup(TyperGroup):
    """A group whose further commands are imported when they are asked for."""

    # typer keeps its click private, so context and command have no public type
    def list_commands(self, ctx: Any) -> list[str]:
        """Name every command without importing it."""
        return sorted({*super().list_commands(ctx), *OWN_COMMANDS, *entry_points(group=PLUGIN_GROUP).names})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import the command if it is not one of this module."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            return command
        if cmd_name in OWN_COMMANDS:
            module, attribute = OWN_COMMANDS[cmd_name].split(":")
            loaded = getattr(importlib.import_module(module), attribute)
        elif cmd_name in entry_points(group=PLUGIN_GROUP).names:
            loaded = entry_points(group=PLUGIN_GROUP)[cmd_name].load()
        else:
            return None
        if not isinstance(loaded, typer.Typer):
            loaded, function = typer.Typer(add_completion=False), loaded
            loaded.command(cmd_name)(function)
        command = typer.main.get_command(loaded)
        command.name = cmd_name
        return command


Report = Callable[[str, float], None]
"""What a long command tells of a stage: its name and the share done in [0, 1]."""

app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Captured trees that move: a sparse voxel spectrum from a tree's shape.",
)

SourcePath = Annotated[
    Path,
    typer.Argument(
        help="A mesh: OBJ (with its MTL and textures beside it), PLY, GLB, glTF or STL. Or a splat: PLY, .splat, SPZ, "
        "GLB. Or a scan: PLY without faces, XYZ text, LAS, LAZ."
    ),
]
BoxCorners = Annotated[
    str | None,
    typer.Option(
        "--box", help="Of a splat or scan, only what is inside moves: x,y,z,x,y,z of low and high corner [m, +Z up]."
    ),
]
MaskPath = Annotated[
    Path | None, typer.Option("--mask", help="Of a splat or scan: .npy, one bool a Gaussian, true where it may move.")
]
BesidePath = Annotated[
    Path | None, typer.Option("--mesh", help="Of a splat or scan: a mesh that lies where it lies, to hang it on.")
]
UpAxis = Annotated[
    str | None, typer.Option(help="Up axis of the input: +X, -X, +Y, -Y, +Z or -Z; detected if not given.")
]
UnitM = Annotated[
    float | None, typer.Option(help="Metres a unit of the input, > 0 (0.01 for centimetres); detected if not given.")
]
Resolution = Annotated[int, typer.Option(help="Voxels along the largest extent: 32, 64, 128, 256 or 512.")]
Seed = Annotated[int, typer.Option(min=0, max=2**63 - 1, help="The same seed gives the same motion.")]
Preset = Annotated[str, typer.Option(help="The model that generates the motion.")]
NumSteps = Annotated[
    int | None, typer.Option(min=1, max=1000, help="Sampler steps; the preset's own number if not given.")
]
WindSpeed = Annotated[float, typer.Option(min=0, max=30, help="Mean wind speed [m/s].")]
WindDirection = Annotated[
    float, typer.Option(min=-360, max=360, help="Where the wind blows to [degrees from +X towards +Y].")
]
Gust = Annotated[float, typer.Option(min=0, max=2, help="Standard deviation of the wind's speed over its mean.")]
OutputFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder for the products; made if it is not there.")]
OutputFile = Annotated[
    Path, typer.Option("--output", "-o", help="File to write; its folder is made if it is not there.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


@app.command()
def animate(
    source: SourcePath,
    output: OutputFolder,
    first_frame: Annotated[int, typer.Option(min=0, max=599, help="Number of the first frame to write.")] = 0,
    frames: Annotated[
        int | None, typer.Option(min=1, help="Frames to write, 1 to 600; one period if not given.")
    ] = None,
    fps: Annotated[
        float, typer.Option(min=1, max=240, help="Frames a second; never changes the motion's speed.")
    ] = 24.0,
    speed: Annotated[float, typer.Option(min=0.01, max=100, help="Times the natural speed.")] = 1.0,
    loop: Annotated[bool, typer.Option(help="Whole periods only, so that the last frame leads to the first.")] = True,
    formats: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="Comma-separated: ply, glb, glb-reduced, glb-skinned, usd, vat, motion (of the mesh), splat-ply, "
            "splat (of the splat), png, webp, mp4. If not given ply,glb,png for a mesh; splat,png for a splat or scan.",
        ),
    ] = None,
    share: Annotated[float, typer.Option(help="Share of a splat's Gaussians to keep, above 0 to 1.")] = 1.0,
    sh_degree: Annotated[int, typer.Option(min=0, max=3, help="Highest degree of a splat's harmonics to keep.")] = 3,
    side_px: Annotated[int, typer.Option(min=64, max=1080, help="Side of the pictures [px].")] = 512,
    azimuth: Annotated[
        float, typer.Option(min=-360, max=360, help="Where the camera stands [degrees], 0 at -Y, then to +X.")
    ] = 25.0,
    elevation: Annotated[float, typer.Option(min=-30, max=80, help="How high it stands [degrees].")] = 8.0,
    orbit: Annotated[bool, typer.Option(help="The camera goes around once while the frames go by.")] = False,
    ground: Annotated[bool, typer.Option(help="Draw a floor.")] = True,
    box: BoxCorners = None,
    mask: MaskPath = None,
    mesh_beside: BesidePath = None,
    resolution: Resolution = 128,
    preset: Preset = "small",
    seed: Seed = 0,
    num_steps: NumSteps = None,
    wind_speed: WindSpeed = 5.0,
    wind_direction: WindDirection = 0.0,
    gust: Gust = 0.3,
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Make a tree sway: mesh or splat → voxels → spectrum → motion files."""
    from dynamictree import pipeline
    from dynamictree.formats.spectrum_file import write_spectrum
    from dynamictree.products import DEFAULT_CLOUD_FORMATS, DEFAULT_FORMATS, FILE_NAMES, AnimateOptions, Facts
    from dynamictree.render.shot import Shot
    from dynamictree.spectrum import Wind

    shot = Shot(side_px=side_px, azimuth_deg=azimuth, elevation_deg=elevation, orbit=orbit, ground=ground)
    named = None if formats is None else tuple(name.strip() for name in formats.split(","))
    options = AnimateOptions(
        first_frame=first_frame,
        num_frames=frames,
        fps=fps,
        speed=speed,
        loop=loop,
        formats=named or DEFAULT_FORMATS,
        share=share,
        sh_degree=sh_degree,
        shot=shot,
    )
    wind = Wind(speed_m_s=wind_speed, direction_deg=wind_direction, gust=gust)
    box_m = _box(box)
    inexact = dict[str, Facts]()
    mesh, capture = _read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=box_m, mask=mask, beside=mesh_beside)
    if capture is not None:
        options = replace(options, formats=named or DEFAULT_CLOUD_FORMATS)
        _tell_size(capture, options, quiet=as_json)
    with _progress(quiet=as_json) as report, _published(output) as folder:
        voxels = pipeline.voxelize(mesh, resolution=resolution)
        report("voxelize", 1.0)
        spectrum = pipeline.diffuse(
            voxels, preset=preset, seed=seed, wind=wind, num_steps=num_steps, on_step=_steps(report, "diffuse")
        )
        with (folder / "tree.spectrum.safetensors").open("wb") as stream:
            write_spectrum(spectrum, stream)
        pipeline.animate(
            mesh,
            spectrum,
            options,
            folder,
            lambda done: report("animate", done),
            capture=capture,
            box_m=box_m,
            on_facts=lambda name, facts: inexact.update({FILE_NAMES[name]: facts}),
        )
        names = sorted(path.name for path in folder.iterdir())
    told: dict[str, Any] = {"files": [str(output / name) for name in names], "num_voxels": len(spectrum.grid)}
    if inexact:
        told["inexact"] = inexact if as_json else [_off_by(name, facts) for name, facts in inexact.items()]
    _tell(told, as_json=as_json)


def _off_by(name: str, facts: "Facts") -> str:
    return (
        f"{name} is off by {1e3 * facts['rms_error_m']:.3g} mm rms ({facts['relative_error']:.2%} of the motion), "
        f"{1e3 * facts['max_error_m']:.3g} mm at most"
    )


@app.command()
def voxelize(
    source: SourcePath,
    output: OutputFile,
    box: BoxCorners = None,
    resolution: Resolution = 128,
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Write the voxels that hold a piece of the tree's surface (*.voxels.safetensors)."""
    from dynamictree import pipeline
    from dynamictree.formats.voxels_file import write_voxels

    mesh, _ = _read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=_box(box))
    voxels = pipeline.voxelize(mesh, resolution=resolution)
    with _published(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_voxels(voxels, stream)
    _tell(
        {"file": str(output), "num_voxels": len(voxels.grid), "voxel_size_m": voxels.grid.voxel_size_m}, as_json=as_json
    )


@app.command()
def diffuse(
    source: Annotated[
        Path, typer.Argument(help="A mesh, a splat, a scan, or a *.voxels.safetensors that `voxelize` wrote.")
    ],
    output: OutputFile,
    box: BoxCorners = None,
    resolution: Resolution = 128,
    preset: Preset = "small",
    seed: Seed = 0,
    num_steps: NumSteps = None,
    wind_speed: WindSpeed = 5.0,
    wind_direction: WindDirection = 0.0,
    gust: Gust = 0.3,
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Generate the spectrum of a tree's motion from its shape (*.spectrum.safetensors)."""
    from dynamictree import pipeline
    from dynamictree.formats.spectrum_file import write_spectrum
    from dynamictree.formats.voxels_file import read_voxels
    from dynamictree.spectrum import Wind

    if source.name.endswith(".safetensors"):
        with _opened(source) as stream:
            voxels = read_voxels(stream)
    else:
        mesh, _ = _read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=_box(box))
        voxels = pipeline.voxelize(mesh, resolution=resolution)
    wind = Wind(speed_m_s=wind_speed, direction_deg=wind_direction, gust=gust)
    with _progress(quiet=as_json) as report:
        on_step = _steps(report, "diffuse")
        spectrum = pipeline.diffuse(voxels, preset=preset, seed=seed, wind=wind, num_steps=num_steps, on_step=on_step)
    with _published(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_spectrum(spectrum, stream)
    _tell({"file": str(output), "num_voxels": len(spectrum.grid), "period_s": spectrum.period_s}, as_json=as_json)


@app.command()
def reconstruct(
    photos: Annotated[
        Path,
        typer.Argument(
            help="A folder of 8 to 300 photos (JPEG, PNG, WebP, TIFF), taken around the tree; cameras in it "
            "(transforms.json, a COLMAP model, poses_bounds.npy) and a folder `masks` are heeded."
        ),
    ],
    output: OutputFolder,
    height_m: Annotated[
        float | None, typer.Option(help="The tree's height [m], above 0 and below 1000; 1 m if unset.")
    ] = None,
    splat_steps: Annotated[
        int | None, typer.Option(min=100, max=30_000, help="How long the splat is learned; 3000 steps if unset.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the cameras of photos, a splat and a mesh of what they show."""
    from dynamictree import pipeline

    if not photos.is_dir():
        raise InputError(f"{photos} is no folder; give the folder that holds the photos")
    paths = sorted(path for path in photos.rglob("*") if path.is_file())
    with _progress(quiet=as_json) as report, _published(output) as folder:
        pipeline.reconstruct(
            paths,
            folder,
            lambda done: report("reconstruct", done),
            root=photos,
            height_m=height_m,
            splat_steps=splat_steps,
        )
        names = sorted(path.name for path in folder.iterdir())
        told = json.loads((folder / "report.json").read_text())
    _tell({"files": [str(output / name) for name in names], **told}, as_json=as_json)


@app.command()
def info(
    source: Annotated[Path, typer.Argument(help="A mesh, splat, scan, voxel or spectrum file.")],
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Say what a file holds."""
    from dynamictree import pipeline
    from dynamictree.describe import describe_capture, describe_grid, describe_mesh, describe_spectrum
    from dynamictree.formats.spectrum_file import read_spectrum
    from dynamictree.formats.voxels_file import read_voxels

    if source.name.endswith(".spectrum.safetensors"):
        with _opened(source) as stream:
            _tell(describe_spectrum(read_spectrum(stream)), as_json=as_json)
    elif source.name.endswith(".voxels.safetensors"):
        with _opened(source) as stream:
            _tell(describe_grid(read_voxels(stream).grid), as_json=as_json)
    elif _is_cloud(source):
        _tell(describe_capture(pipeline.load_capture(source, up_axis=up_axis, unit_m=unit_m)), as_json=as_json)
    else:
        _tell(describe_mesh(_read_mesh(source, up_axis=up_axis, unit_m=unit_m)), as_json=as_json)


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Report]:
    """A bar a stage on standard error; none where a program reads the output."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as progress:
        bars: dict[str, TaskID] = {}

        def report(stage: str, done: float) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=1.0)
            progress.update(bars[stage], completed=done)

        yield report


def _steps(report: Report, stage: str) -> "OnStep":
    """A sampler's step counter as a stage's share."""
    return lambda done, total: report(stage, done / total)


@contextmanager
def _published(folder: Path) -> Iterator[Path]:
    """A folder to write in whose files appear in `folder` all at once at the end, or not at all."""
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    written = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder))
    try:
        yield written
        for path in sorted(written.iterdir()):
            path.replace(folder / path.name)
    except BaseException:
        shutil.rmtree(written)
        if made:
            folder.rmdir()
        raise
    written.rmdir()


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file that the user named, or say in a line why not."""
    try:
        stream = path.open("rb")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    with stream:
        yield stream


def _read_source(
    path: Path,
    *,
    up_axis: str | None,
    unit_m: float | None,
    box_m: "Box | None" = None,
    mask: Path | None = None,
    beside: Path | None = None,
) -> "tuple[TriangleMesh, Capture | None]":
    """The mesh that a file holds; or the cloud, and the mesh that carries what of it moves."""
    from dynamictree import pipeline
    from dynamictree.gaussian.capture import carrying_mesh

    if not _is_cloud(path):
        if box_m is not None or mask is not None or beside is not None:
            raise InputError(f"{path} is a mesh; --box, --mask and --mesh are for splats and scans")
        return _read_mesh(path, up_axis=up_axis, unit_m=unit_m), None
    for other in (mask, beside):
        if other is not None:
            with _opened(other):
                pass
    capture = pipeline.load_capture(path, up_axis=up_axis, unit_m=unit_m, mask=mask, mesh=beside)
    return carrying_mesh(capture, box_m), capture


def _is_cloud(path: Path) -> bool:
    from dynamictree.formats.source_file import source_kind

    with _opened(path) as stream:
        return source_kind(stream, path.name)[0] == "cloud"


def _box(corners: str | None) -> "Box | None":
    if corners is None:
        return None
    try:
        x0, y0, z0, x1, y1, z1 = (float(value) for value in corners.split(","))
    except ValueError:
        raise InputError(f"--box is {corners!r}; six numbers are needed: x,y,z,x,y,z of low and high corner") from None
    return (x0, y0, z0), (x1, y1, z1)


def _tell_size(capture: "Capture", options: "AnimateOptions", *, quiet: bool) -> None:
    """Say how large a sequence of splats will be, before it is made."""
    from dynamictree.spectrum import FPS, NUM_FRAMES
    from dynamictree.splat_products import describe_sequence

    if "splat-ply" in options.formats:
        told = describe_sequence(capture.cloud, len(options.phases(NUM_FRAMES / FPS)), options)
        if not quiet:
            print(f"splat-ply: {told}", file=sys.stderr)


def _read_mesh(path: Path, *, up_axis: str | None, unit_m: float | None) -> "TriangleMesh":
    """Read a mesh that the user named, with the files of its folder that it may name."""
    from dynamictree import pipeline

    with _opened(path):
        companions = pipeline.companions_beside(path)
    return pipeline.load_mesh(path, companions=companions, up_axis=up_axis, unit_m=unit_m)


def _tell(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print what came out, for a person or for a program."""
    if as_json:
        print(json.dumps(facts))
        return
    for name, value in facts.items():
        print(f"{name}: {', '.join(map(str, value)) if isinstance(value, list) else value}")


def main() -> None:
    """Run the command line; what the user can mend is one line and exit status 2."""
    try:
        app()
    except DynamicTreeError as error:
        print(f"dynamictree: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
