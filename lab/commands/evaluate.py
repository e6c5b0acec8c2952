"""`dynamictree evaluate`: compare a model with its baselines on held-out trees."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynamictree.commands.terminal import AsJson
from dynamictree.errors import InputError
from dynamictree.requests import Reading
from lab.training.progress import bars

if TYPE_CHECKING:
    from dynamictree.mesh import TriangleMesh
    from dynamictree.spectrum import SparseVoxelSpectrum, Wind
    from lab.evaluation.clip import ClipEmbedder


def evaluate(
    model: Annotated[str, typer.Option(help="Model name, or a .safetensors file.")] = "small",
    trees: Annotated[int, typer.Option(min=1, max=10_000, help="Trees per group: seen and unseen species.")] = 6,
    training_trees: Annotated[
        int, typer.Option(min=1, max=10_000, help="Number of training trees for the baselines.")
    ] = 40,
    first_seed: Annotated[int, typer.Option(min=0, max=2**40, help="First seed of the training trees.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the generated motions.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, max=1000, help="Sampler steps; by default the preset's.")] = None,
    samples: Annotated[
        Path | None,
        typer.Option(
            envvar="DYNAMICTREE_SAMPLES",
            exists=True,
            file_okay=False,
            help="Folder of trees (.npz) from Blender's Sapling add-on, as a third group.",
        ),
    ] = None,
    classifier: Annotated[
        bool, typer.Option(help="Instead, train a classifier to separate generated from true motions (slow).")
    ] = False,
    laws: Annotated[
        bool, typer.Option(help="Instead, check the simulator against measurements of real trees, from 1 to 35 m.")
    ] = False,
    generated: Annotated[
        bool, typer.Option(help="With --laws: check the model's motions of these trees, not the simulator's.")
    ] = False,
    tree: Annotated[
        Path | None,
        typer.Option(
            help="With --laws: check the model's motion of this mesh, splat or scan, or of the one in this folder.",
            exists=True,
        ),
    ] = None,
    height_m: Annotated[
        float | None, typer.Option(min=0.01, max=999.0, help="Height of that tree \\[m]; by default the file's.")
    ] = None,
    classifier_trees: Annotated[int, typer.Option(min=20, max=100_000, help="Trees per class.")] = 200,
    max_voxels: Annotated[
        int, typer.Option(min=1000, max=150_000, help="Largest number of voxels of a tree, for the classifier.")
    ] = 150_000,
    clip: Annotated[
        Path | None,
        typer.Option(help="CLIP's ViT-B/32 (model.safetensors, or its folder), for CLIP-I and CLIP-T.", exists=True),
    ] = None,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Threads of this process.")] = 2,
    as_json: AsJson = False,
) -> None:
    """Measure a model and its baselines on held-out trees; print a table or JSON."""
    import torch

    torch.set_num_threads(threads)
    if classifier and laws:
        raise InputError("--classifier and --laws are separate runs; give one of them")
    if (tree is not None or generated) and not laws:
        raise InputError(
            "--tree and --generated are for --laws; without it the model is measured on trees of known motion"
        )
    if tree is not None and generated:
        raise InputError("--generated takes trees that are grown, --tree one of yours; give one of them")
    if height_m is not None and tree is None:
        raise InputError("--height-m is the height of --tree; give that too")
    if laws:
        from lab.evaluation.laws import evaluate_laws

        if tree is not None:
            of_tree = _laws_of(tree, Reading(height_m=height_m), model, seed)
            typer.echo(json.dumps(of_tree)) if as_json else print_tree_laws(of_tree)
            return
        with bars(quiet=as_json) as on_step:
            of_model = partial(_motion_of, model=model, seed=seed) if generated else None
            report = evaluate_laws(trees, seed=seed, model=of_model, on_step=on_step)
        typer.echo(json.dumps(report)) if as_json else print_laws(report)
        return
    files, embedder = ((), None) if classifier else (_sapling(samples), _embedder(clip))
    with bars(quiet=as_json) as on_step:
        if classifier:
            from lab.evaluation.classifier import classify

            report = classify(model, num_trees=classifier_trees, max_voxels=max_voxels, seed=seed, on_step=on_step)
        else:
            from lab.evaluation.report import evaluate_model

            report = evaluate_model(
                model,
                num_trees=trees,
                num_training=training_trees,
                first_seed=first_seed,
                seed=seed,
                num_steps=steps,
                sapling=files,
                embedder=embedder,
                on_step=on_step,
            )
    if as_json:
        typer.echo(json.dumps(report))
    elif classifier:
        print_classifier(report)
    else:
        print_figures(report)


def _sapling(folder: Path | None) -> Sequence[Path]:
    """Find the trees of Blender's Sapling add-on; print one line if there are none."""
    from lab.evaluation.held_out_trees import sapling_files

    if folder is None:
        typer.echo("no trees of the Sapling add-on: give their folder with --samples to judge on them too", err=True)
        return ()
    return sapling_files(folder)


def _embedder(clip: Path | None) -> "ClipEmbedder | None":
    """Load CLIP's image tower; print one line if it is not given."""
    from lab.evaluation.clip import load_clip

    if clip is None:
        typer.echo("no frames are judged: --clip does, with the file of ViT-B/32's weights", err=True)
        return None
    return load_clip(clip)


def _laws_of(path: Path, reading: Reading, model: str, seed: int) -> dict[str, Any]:
    from dynamictree.commands.input_files import read_source
    from dynamictree.commands.options import shape_file
    from lab.evaluation.laws import measure_generated, satisfied_laws

    path = shape_file(path)
    measured = measure_generated(path.name, _motion_of(read_source(path, reading)[0], model=model, seed=seed))
    return {"tree": asdict(measured), "laws": satisfied_laws(measured)}


def _motion_of(shape: "TriangleMesh", *, model: str, seed: int) -> "Callable[[Wind], SparseVoxelSpectrum]":
    """Return a function that generates the shape's motion in a wind."""
    from dynamictree import method

    voxels = method.voxelize(shape)
    return lambda wind: method.generate(voxels, wind=wind, seed=seed, model=model)


def print_figures(report: dict[str, Any]) -> None:
    """Print the figures of each group, the targets, and whether the model passes."""
    for group, rows in report["groups"].items():
        _print_columns(f"{group}: mean over {report['trees'][group]} trees", rows)
    for group, rows in report["frame_distances"].items():
        _print_columns(f"{group}: distances of frames", rows)
    for target in report["targets"]:
        verdict = "met" if target["met"] else f"missed by {target['missed_by']:.3f}"
        name = target["figure"].replace("_", " ")
        value = f"{target['value']:.3f} (a second true wind {target['floor']:.3f})"
        typer.echo(f"{name} {target['wanted']}: {value}, {verdict}")
    verdict = "passes" if report["passes"] else "does not pass"
    typer.echo(f"{report['model']} {verdict}: {report['rule']}")


def print_classifier(report: dict[str, Any]) -> None:
    """Print the accuracy of the classifier, and whether the result is valid."""
    for kind, share in report["right"].items():
        typer.echo(f"true motion and {kind} separated in {100 * share:.1f} % of cases")
    verdict = "valid" if report["valid"] else "not valid"
    typer.echo(f"{verdict}: {report['rule']}; {report['trees']} trees a side, {report['mean_voxels']:,.0f} voxels each")


def print_laws(report: dict[str, Any]) -> None:
    """Print the share of trees that satisfy each law, and medians."""
    _print_columns(f"share of {len(report['trees'])} trees", {"share": report["laws"]})
    _print_columns("medians", {"median": report["medians"]})


def print_tree_laws(report: dict[str, Any]) -> None:
    """Print what was measured of one tree's motion, and which laws it satisfies."""
    tree = report["tree"]
    measured = {name: value for name, value in tree.items() if name != "species"}
    _print_columns(f"{tree['species']}: measured", {"value": measured})
    for law, holds in report["laws"].items():
        typer.echo(
            f"{law}: {'not measured on real trees of this height' if holds is None else 'yes' if holds else 'no'}"
        )


def _print_columns(title: str, rows: Mapping[str, Mapping[str, float]]) -> None:
    """Print a table with a column per method and a row per figure."""
    from rich.console import Console
    from rich.table import Table

    table = Table()
    table.add_column("figure", no_wrap=True)
    for method in rows:
        table.add_column(method, justify="right")
    for figure in next(iter(rows.values())):
        cells = (f"{of_method[figure]:.3f}" if figure in of_method else "" for of_method in rows.values())
        table.add_row(figure.replace("_", " "), *cells)
    typer.echo(title)
    console = Console()
    Console(width=max(console.width, 140)).print(table)
