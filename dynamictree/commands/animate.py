"""`dynamictree animate`: a shape to files that show its motion."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynamictree.commands.options import (
    BoxCorners,
    Gust,
    NumSteps,
    OutputFolder,
    Preset,
    Resolution,
    Seed,
    SourcePath,
    UnitM,
    UpAxis,
    WindDirection,
    WindSpeed,
    box_of,
)
from dynamictree.commands.source import read_source
from dynamictree.files import published
from dynamictree.terminal import AsJson, progress, tell

if TYPE_CHECKING:
    from dynamictree.gaussian.capture import Capture
    from dynamictree.products import AnimateOptions, Facts


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
    mask: Annotated[
        Path | None,
        typer.Option(help="Of a splat or scan: .npy, one bool a Gaussian, true where it may move."),
    ] = None,
    mesh_beside: Annotated[
        Path | None, typer.Option("--mesh", help="Of a splat or scan: a mesh that lies where it lies, to hang it on.")
    ] = None,
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
    from dynamictree.formats.tensors.spectrum import write_spectrum
    from dynamictree.products import DEFAULT_CLOUD_FORMATS, DEFAULT_FORMATS, FILE_NAMES, AnimateOptions
    from dynamictree.render.shot import Shot
    from dynamictree.spectrum import Wind

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
        shot=Shot(side_px=side_px, azimuth_deg=azimuth, elevation_deg=elevation, orbit=orbit, ground=ground),
    )
    box_m = box_of(box)
    mesh, capture = read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=box_m, mask=mask, beside=mesh_beside)
    if capture is not None:
        options = replace(options, formats=named or DEFAULT_CLOUD_FORMATS)
        _tell_size(capture, options, quiet=as_json)
    inexact: dict[str, Facts] = {}
    with progress(quiet=as_json) as report, published(output) as folder:
        voxels = pipeline.voxelize(mesh, resolution=resolution)
        report("voxelize", 1.0)
        spectrum = pipeline.diffuse(
            voxels,
            preset=preset,
            seed=seed,
            wind=Wind(speed_m_s=wind_speed, direction_deg=wind_direction, gust=gust),
            num_steps=num_steps,
            on_step=lambda done, total: report("diffuse", done / total),
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
    tell(told, as_json=as_json)


def _tell_size(capture: "Capture", options: "AnimateOptions", *, quiet: bool) -> None:
    """Say how large a sequence of splats will be, before it is made."""
    from dynamictree.spectrum import FPS, NUM_FRAMES
    from dynamictree.splat_products import describe_sequence

    if "splat-ply" in options.formats:
        told = describe_sequence(capture.cloud, len(options.phases(NUM_FRAMES / FPS)), options)
        if not quiet:
            typer.echo(f"splat-ply: {told}", err=True)


def _off_by(name: str, facts: "Facts") -> str:
    return (
        f"{name} is off by {1e3 * facts['rms_error_m']:.3g} mm rms ({facts['relative_error']:.2%} of the motion), "
        f"{1e3 * facts['max_error_m']:.3g} mm at most"
    )
