"""Run one attempt of a job: stage after stage, each from the cache where its inputs are the same."""

import json
import logging
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from dynamictree.errors import Cancelled, CheckpointError, DynamicTreeError
from dynamictree.photo_requests import LearningParams
from dynamictree.request_model import Request
from dynamictree.requests import CloudParams, ExportParams, GridParams, ReconstructParams, SpectrumParams
from dynamictree.weights import list_weights
from jobs.lifecycle.attempts import cached_stage, offer, publish_stage, start_stage, touch_blob
from jobs.records import AssetRecord, JobRecord, OutputFile
from jobs.states import JobType
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import read_asset
from jobs.storage.intermediates import RESULT_SOURCES, find_intermediate, intermediate_key, remember_intermediate
from jobs.storage.stage_files import CLOUD_BUNDLE, MESH_BUNDLE, SPECTRUM, STAGE_VERSION, VOXELS
from worker.cancellation import Watch
from worker.half_done import alone_in, half_done_folder
from worker.runtime import Runtime

if TYPE_CHECKING:
    from dynamictree.export.vertex_motion import Result
    from worker.stages import StageInput

logger = logging.getLogger(__name__)

SOURCE = "source"
INPUTS: dict[JobType, tuple[str, ...]] = {
    "reconstruct": (SOURCE,),
    "voxelize": (MESH_BUNDLE,),
    "diffuse": (VOXELS,),
    "animate": (SPECTRUM, MESH_BUNDLE, CLOUD_BUNDLE),
}
PARAMS: dict[JobType, tuple[type[Request], ...]] = {
    "reconstruct": (ReconstructParams,),
    "voxelize": (GridParams, CloudParams),
    "diffuse": (SpectrumParams,),
    "animate": (ExportParams, CloudParams),
}
"""The files and parameters that change what a stage makes."""

OCTETS = "application/octet-stream"


def run_stages(runtime: Runtime, watch: Watch) -> None:
    """Run the remaining stages. An exception of a stage passes through."""
    # numba and the formats come in with the first job, so that a worker is there at once
    from worker.stages import STAGES, StageInput, photo_name

    job = watch.claimed.job
    asset = read_asset(runtime.store, job.asset_id)
    folder = runtime.settings.scratch_dir / f"job-{job.id}-{job.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    inputs = folder / "inputs"
    inputs.mkdir(parents=True)
    try:
        files = _fetch_prepared(runtime, asset, inputs)
        photos = _fetch_photos(runtime, asset, inputs / "photos", photo_name)
        hashes = dict.fromkeys((MESH_BUNDLE, CLOUD_BUNDLE, SOURCE), asset.fingerprint)
        sources = _prepared_sources(asset)
        for stage in job.stages:
            watch.check()
            outputs = _finished(runtime, job, stage.name)
            key = "" if outputs else stage_key(job, stage.name, hashes)
            if outputs is None:
                outputs = _from_cache(runtime, watch, stage.name, key)
            if outputs is None:
                start_stage(runtime.store, watch.claimed, stage.name)
                own = folder / stage.name
                own.mkdir()
                given = StageInput(
                    job=job,
                    folder=own,
                    resume_dir=half_done_folder(runtime.settings, job),
                    files=files,
                    source_sha256="" if asset.kind == "photos" else asset.parts[0].sha256,
                    photos=photos,
                    report=partial(watch.report, stage.name),
                    recall=partial(_recall, runtime, watch, stage.name, own, sources),
                    publish=partial(_publish_part, runtime, watch, stage.name),
                )
                outputs = _run_stage(runtime, watch, stage.name, STAGES[stage.name], given)
                _publish(runtime, watch, stage.name, outputs, key=key, cached=False)
            for file in outputs:
                runtime.artifacts.fetch(file.sha256, inputs / file.name)
                files[file.name] = inputs / file.name
                hashes[file.name] = file.sha256
                sources[file.name] = file
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run_stage(
    runtime: Runtime, watch: Watch, stage: JobType, run: Callable[["StageInput"], Iterable[Path]], given: "StageInput"
) -> tuple[OutputFile, ...]:
    """Run a stage; files that it wrote before a failure are published too, since they may explain it."""
    try:
        return _keep(runtime, run(given), given.facts)
    except Cancelled:
        raise
    except DynamicTreeError:
        left = _keep(
            runtime,
            sorted(path for path in given.folder.iterdir() if path.is_file() and path.name[0] != "."),
            given.facts,
        )
        offer(runtime.store, watch.claimed, stage, left, retention_s=runtime.settings.artifact_retention_s)
        raise


def stage_key(job: JobRecord, stage: JobType, hashes: Mapping[str, str]) -> str:
    """sha256 of all inputs of a stage: files, parameters, seed, model and code."""
    inputs = {name: hashes[name] for name in INPUTS[stage]}
    params = [model.part_of(job.params).model_dump(mode="json") for model in PARAMS[stage]]
    meaning: list[object] = [stage, STAGE_VERSION, version("dynamictree"), inputs, params]
    if job.owner:  # a hit would tell one owner what another has sent
        meaning.append(job.owner)
    if stage == "diffuse":
        meaning += [job.seed, job.preset, model_sha256(job.preset)]
    return sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()


@cache
def model_sha256(preset: str) -> str:
    """Hash of a model's weights.

    Raises:
        CheckpointError: this worker has none.
    """
    path = list_weights().get(preset)
    if path is None:
        raise CheckpointError(
            f"this worker has no weights of the preset {preset!r}; put them into the folder DYNAMICTREE_MODELS"
        )
    return sha256(path.read_bytes()).hexdigest()


def _fetch_prepared(runtime: Runtime, asset: AssetRecord, inputs: Path) -> dict[str, Path]:
    """The mesh or cloud that the parser wrote."""
    if asset.prepared is None:
        return {}
    name = CLOUD_BUNDLE if asset.kind == "cloud" else MESH_BUNDLE
    runtime.artifacts.fetch(asset.prepared.sha256, inputs / name)
    return {name: inputs / name}


def _prepared_sources(asset: AssetRecord) -> dict[str, OutputFile]:
    """The file that the parser wrote, as stages name theirs; of photos all parts, and what they mean together."""
    if asset.prepared is None:
        meaning = OutputFile(name=SOURCE, media_type=OCTETS, sha256=asset.fingerprint, bytes=0)
        parts = [
            OutputFile(name=part.name, media_type=OCTETS, sha256=part.sha256, bytes=part.bytes) for part in asset.parts
        ]
        return {SOURCE: meaning} | {f"{SOURCE}/{index}": part for index, part in enumerate(parts)}
    name = CLOUD_BUNDLE if asset.kind == "cloud" else MESH_BUNDLE
    part = asset.prepared
    return {name: OutputFile(name=name, media_type=OCTETS, sha256=part.sha256, bytes=part.bytes)}


def _recall(
    runtime: Runtime,
    watch: Watch,
    stage: JobType,
    folder: Path,
    sources: Mapping[str, OutputFile],
    name: "Result",
    make: Callable[[Path], None],
) -> Path:
    """The file of a result that does not depend on the formats: an earlier job's, or computed and remembered."""
    job = watch.claimed.job
    path = folder / f".{name}"
    if name == "reconstruction":
        used = [file for source, file in sources.items() if source.startswith(SOURCE)]
        choice = LearningParams.part_of(job.params).model_dump(mode="json")
    else:
        used = [sources[source] for source in RESULT_SOURCES[name]]
        choice = CloudParams.part_of(job.params).model_dump(mode="json")
    key = intermediate_key(name, job, [file.sha256 for file in used], choice)
    find = partial(find_intermediate, runtime.store, runtime.artifacts, key)
    file = find()
    if file is not None:
        runtime.artifacts.fetch(file.sha256, path)
    elif name == "reconstruction":
        file = _learn(runtime, watch, stage, path, find, make)
    else:
        make(path)
        file = _stored(runtime, path, name)
    remember_intermediate(runtime.store, key, name, file, used, owner=job.owner)
    return path


def _learn(
    runtime: Runtime,
    watch: Watch,
    stage: JobType,
    path: Path,
    find: Callable[[], OutputFile | None],
    make: Callable[[Path], None],
) -> OutputFile:
    """Learn a scene from photos, one job at a time; those that waited find what the first one learned."""
    job = watch.claimed.job
    folder = half_done_folder(runtime.settings, job)
    with alone_in(folder, partial(watch.report, stage, 0.0)) as waited:
        if waited and (file := find()) is not None:
            runtime.artifacts.fetch(file.sha256, path)
            return file
        make(path)
        return _stored(runtime, path, "reconstruction")


def _stored(runtime: Runtime, path: Path, name: str) -> OutputFile:
    digest, size = hash_file(path)
    touch_blob(runtime.store, digest, size)
    runtime.artifacts.put(path, digest)
    return OutputFile(name=name, media_type=OCTETS, sha256=digest, bytes=size)


def _fetch_photos(
    runtime: Runtime, asset: AssetRecord, folder: Path, name_of: Callable[[int, str], str]
) -> tuple[Path, ...]:
    """Photos, and the cameras and masks that came with them, under their own names; in the order sent."""
    if asset.kind != "photos":
        return ()
    paths = []
    for index, part in enumerate(asset.parts):
        path = folder / name_of(index, part.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        runtime.artifacts.fetch(part.sha256, path)
        paths.append(path)
    return tuple(paths)


def _finished(runtime: Runtime, job: JobRecord, stage: JobType) -> tuple[OutputFile, ...] | None:
    """Files that an earlier attempt of this job published."""
    if not any(other.name == stage and other.state == "succeeded" for other in job.stages):
        return None
    outputs = [artifact for artifact in runtime.store.artifacts_of(job.id) if artifact.stage == stage]
    return tuple(
        OutputFile(name=a.name, media_type=a.media_type, sha256=a.sha256, bytes=a.bytes, facts=a.facts) for a in outputs
    )


def _from_cache(runtime: Runtime, watch: Watch, stage: JobType, key: str) -> tuple[OutputFile, ...] | None:
    """Files that any job made from the same inputs, if all their bytes are stored."""
    files = cached_stage(runtime.store, key)
    if files is None:
        return None
    for file in files:
        touch_blob(runtime.store, file.sha256, file.bytes)
    if not all(runtime.artifacts.exists(file.sha256) for file in files):
        return None
    start_stage(runtime.store, watch.claimed, stage)
    _publish(runtime, watch, stage, files, key=key, cached=True)
    return files


def _keep(
    runtime: Runtime, paths: Iterable[Path], facts: Mapping[str, Mapping[str, int | float]]
) -> tuple[OutputFile, ...]:
    from dynamictree.export.table import media_type  # with the stages, not at start

    outputs = []
    for path in paths:
        digest, size = hash_file(path)
        touch_blob(runtime.store, digest, size)
        runtime.artifacts.put(path, digest)
        file = OutputFile(name=path.name, media_type=media_type(path.name), sha256=digest, bytes=size)
        outputs.append(replace(file, facts=facts.get(path.name, {})))
    return tuple(outputs)


def _publish_part(runtime: Runtime, watch: Watch, stage: JobType, path: Path) -> None:
    """Publish a file of a stage that goes on; the stage's end replaces it."""
    offer(
        runtime.store,
        watch.claimed,
        stage,
        _keep(runtime, [path], {}),
        retention_s=runtime.settings.artifact_retention_s,
    )


def _publish(
    runtime: Runtime, watch: Watch, stage: JobType, files: tuple[OutputFile, ...], *, key: str, cached: bool
) -> None:
    retention_s = runtime.settings.artifact_retention_s
    publish_stage(runtime.store, watch.claimed, stage, files, key=key, cached=cached, retention_s=retention_s)
    logger.info("stage %s of job %s published", stage, watch.claimed.job.id, extra={"cached": cached})
