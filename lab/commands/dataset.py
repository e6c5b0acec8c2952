"""`dynamictree dataset`: generate, filter, sheet."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.errors import InputError
from lab.dataset.limits import DatasetLimits
from lab.training.progress import bars

app = typer.Typer(no_args_is_help=True, help="Generate, filter and review 4DTree, a data set of animated trees.")

Folder = Annotated[Path, typer.Argument(help="Folder of the dataset.")]
BakedFolder = Annotated[
    Path | None,
    typer.Argument(help="Folder of a dataset, whose records are used; by default trees from seeds.", exists=True),
]
FirstSeed = Annotated[int, typer.Option(min=0, max=2**40, help="Seed of the first tree.")]
Workers = Annotated[int, typer.Option(min=1, max=256, help="Number of processes; it does not affect the bytes.")]
SpeciesName = Annotated[str | None, typer.Option(help="Only this species; by default drawn from the seed.")]


@app.command()
@with_request_options
def generate(
    folder: Folder,
    limits: DatasetLimits,
    trees: Annotated[int, typer.Option(min=1, max=10_000_000, help="Number of accepted trees.")] = 8786,
    first_seed: FirstSeed = 0,
    trees_per_shard: Annotated[int, typer.Option(min=1, max=1000, help="Trees per file.")] = 25,
    resolution: Annotated[
        list[int], typer.Option(help="Voxels along the largest extent, 32 to 512; several are allowed.")
    ] = [128],  # noqa: B006 typer copies it
    review: Annotated[
        Path | None,
        typer.Option(help="Review file with verdicts, as `dataset sheet` writes.", exists=True, dir_okay=False),
    ] = None,
    shard: Annotated[
        str, typer.Option(help="i/n: generate only every n-th shard from the i-th (0 to n-1) on.")
    ] = "0/1",
    species: Annotated[
        str | None, typer.Option(help="Only this species, or `crossed` (mixed); by default drawn.")
    ] = None,
    workers: Workers = 1,
    as_json: AsJson = False,
) -> None:
    """Generate a dataset in a folder; continue an interrupted run."""
    from lab.dataset import generate as baking
    from lab.dataset.review import read_review

    verdicts = {}
    if review is not None:
        with review.open("rb") as stream:
            verdicts = read_review(stream)
    recipe = baking.Recipe(
        trees=trees,
        first_seed=first_seed,
        trees_per_shard=trees_per_shard,
        resolutions=tuple(resolution),
        species=species,
        limits=limits,
        review=verdicts,
    )
    with bars(quiet=as_json) as report:
        manifest = baking.generate(
            recipe,
            folder,
            workers=workers,
            part=_part(shard),
            on_shard=lambda done, total: report("trees", done, total, 0.0),
        )
    facts = {name: value for name, value in manifest.items() if name != "shards"}
    show_result({"folder": str(folder), **facts}, as_json=as_json)


@app.command(name="filter")
@with_request_options
def filter_trees(
    limits: DatasetLimits,
    folder: BakedFolder = None,
    trees: Annotated[int, typer.Option(min=1, max=1_000_000, help="Number of trees from seeds.")] = 100,
    first_seed: FirstSeed = 0,
    species: SpeciesName = None,
    as_json: AsJson = False,
) -> None:
    """Print how many trees each rule would reject, and the worst value of each measure; write nothing."""
    from dataclasses import asdict

    from lab.dataset.filter import iter_measured, measure, rejections
    from lab.dataset.sample import make_sample

    if folder is not None:
        measures = [tree.measures for tree in iter_measured(folder) if species in (None, tree.species)]
        trees = len(measures)
        if trees == 0:
            raise InputError(f"no tree in {folder} is of species {species!r}; leave --species out to see all")
    else:
        measures = []
        with bars(quiet=as_json) as report:
            for index in range(trees):
                measures.append(measure(make_sample(first_seed + index, species), limits))
                report("trees", index + 1, trees, 0.0)
    counts = rejections(one.violated(limits) for one in measures)
    rates = {f"rejected {rule}": f"{count} of {trees} ({100 * count / trees:.2f} %)" for rule, count in counts.items()
             if rule not in ("seen", "accepted")}  # fmt: skip
    worst = {name: max(getattr(one, name) for one in measures) for name in asdict(measures[0])}
    if as_json:
        show_result({**counts, "worst": worst, "limits": limits.model_dump()}, as_json=True)
    else:
        worst_rows = {f"worst {name}": f"{value:.3g}" for name, value in worst.items()}
        show_result({"trees": trees, "accepted": counts["accepted"], **rates, **worst_rows}, as_json=False)


@app.command()
def sheet(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pages and the review file.")],
    folder: BakedFolder = None,
    trees: Annotated[int, typer.Option(min=1, max=100_000, help="Number of trees.")] = 24,
    first_seed: FirstSeed = 0,
    species: SpeciesName = None,
    rows: Annotated[int, typer.Option(min=1, max=50, help="Trees per page.")] = 12,
    as_json: AsJson = False,
) -> None:
    """Draw pages of trees with motion strips, and write a review file, in which trees can be rejected."""
    from dynamictree.render import write_png
    from lab.dataset.contact_sheet import draw_sheet
    from lab.dataset.filter import iter_measured
    from lab.dataset.review import write_review
    from lab.dataset.sample import make_sample

    output.mkdir(parents=True, exist_ok=True)
    seeds: Sequence[int] = range(first_seed, first_seed + trees)
    if folder is not None:
        accepted = (tree for tree in iter_measured(folder) if not tree.violated and species in (None, tree.species))
        seeds = [tree.seed for tree in accepted if tree.seed >= first_seed][:trees]
    notes: dict[int, str] = {}
    files = []
    with bars(quiet=as_json) as report:
        for start in range(0, len(seeds), rows):
            samples = [make_sample(seed, species) for seed in seeds[start : start + rows]]
            notes |= {sample.seed: sample.species for sample in samples}
            files.append(output / f"sheet-{start // rows:04d}.png")
            with files[-1].open("wb") as stream:
                write_png(draw_sheet(samples), stream)
            report("trees", min(start + rows, len(seeds)), len(seeds), 0.0)
    review = output / "review.txt"
    if not review.exists():  # never overwrite a person's review
        with review.open("wb") as stream:
            write_review(dict.fromkeys(seeds, "accept"), stream, notes=notes)
    show_result({"pages": [str(path) for path in files], "review": str(review)}, as_json=as_json)


def _part(text: str) -> tuple[int, int]:
    """Parse `i/n` as two numbers."""
    index, slash, count = text.partition("/")
    if not (slash and index.isdigit() and count.isdigit()):
        raise InputError(f"--shard is {text!r}; write i/n, 0/1 for all of the work")
    return int(index), int(count)
