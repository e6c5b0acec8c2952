"""Run one attempt of a job: its stages in order, each from the cache if its inputs are the same."""

import logging
import shutil
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cache, partial
from hashlib import sha256
from pathlib import Path

import obstore

from dynamictree.errors import Cancelled, CheckpointError, DynamicTreeError
from dynamictree.memory import return_freed_memory
from dynamictree.photo_requests import LearningParams
from dynamictree.request_model import Request
from dynamictree.requests import CloudParams, ExportParams, GridParams, ReconstructParams, SpectrumParams
from dynamictree.weights import list_weights
from jobs.lifecycle.attempts import publish, publish_stage, start_stage, touch_blob
from jobs.records import AssetRecord, Facts, JobRecord, OutputFile
from jobs.states import JobType
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import read_asset
from jobs.storage.intermediates import RESULT_SOURCES, find_stored, remember_intermediate, result_key
from jobs.storage.object_storage import open_objects, reporting_refusals
from jobs.storage.stage_files import CLOUD_BUNDLE, MESH_BUNDLE, SPECTRUM, VOXELS
from worker.cancellation import Watch
from worker.half_done import half_done_folder, locked_folder
from worker.runtime import Runtime

logger = logging.getLogger(__name__)

SOURCE_KEY = "source"
INPUTS: dict[JobType, tuple[str, ...]] = {
    "reconstruct": (SOURCE_KEY,),
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
"""Files and parameters that determine the output of each stage."""

MEDIA_TYPE = "application/octet-stream"


def run_stages(runtime: Runtime, watch: Watch) -> None:
    """Run the remaining stages. An exception of a stage passes through."""
    job = watch.claimed.job
    folder = runtime.settings.scratch_dir / f"job-{job.id}-{job.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "inputs").mkdir(parents=True)
    try:
        attempt = Attempt(runtime=runtime, watch=watch, folder=folder, asset=read_asset(runtime.store, job.asset_id))
        attempt.fetch()
        for stage in job.stages:
            watch.check()
            attempt.take(attempt.outputs_of(stage.name))
            return_freed_memory()  # the network leaves 400 MB; the fit of turns would add to them
        if job.destination is not None:
            attempt.deliver(job.destination)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def stage_key(job: JobRecord, stage: JobType, hashes: Mapping[str, str]) -> str:
    """Return the sha256 of all inputs of a stage: files, parameters, seed, model and code."""
    params = [model.part_of(job.params).model_dump(mode="json") for model in PARAMS[stage]]
    model = [job.seed, job.preset, model_sha256(job.preset)] if stage == "diffuse" else []
    return result_key(stage, job, [hashes[name] for name in INPUTS[stage]], *params, *model)


@cache
def model_sha256(preset: str) -> str:
    """Return the hash of a model's weights.

    Raises:
        CheckpointError: this worker does not have the weights.
    """
    path = list_weights().get(preset)
    if path is None:
        raise CheckpointError(
            f"this worker has no weights of the preset {preset!r}; put them into the folder DYNAMICTREE_MODELS"
        )
    return sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One attempt of a job: the files and hashes available to its stages."""

    runtime: Runtime
    watch: Watch
    folder: Path
    asset: AssetRecord
    files: dict[str, Path] = field(default_factory=dict)  # local paths, by the names that stages use
    sources: dict[str, OutputFile] = field(default_factory=dict)  # stored files and photos, as sources of results
    hashes: dict[str, str] = field(default_factory=dict)  # inputs of the stages' keys
    photos: list[Path] = field(default_factory=list)  # photos, cameras and masks, under the names as sent

    @property
    def job(self) -> JobRecord:
        """Return the job of the attempt."""
        return self.watch.claimed.job

    def fetch(self) -> None:
        """Fetch the asset: the mesh or cloud that the parser wrote, or the photos."""
        from worker.stages import photo_name  # imports numba and the formats, at the first job

        asset = self.asset
        self.hashes.update(dict.fromkeys((MESH_BUNDLE, CLOUD_BUNDLE, SOURCE_KEY), asset.fingerprint))
        if asset.prepared is not None:
            name = CLOUD_BUNDLE if asset.kind == "cloud" else MESH_BUNDLE
            self.take([_output_file(name, asset.prepared.sha256, asset.prepared.bytes)])
            self.hashes[name] = asset.fingerprint
            return
        self.sources[SOURCE_KEY] = _output_file(SOURCE_KEY, asset.fingerprint, 0)
        for index, part in enumerate(asset.parts):
            self.sources[f"{SOURCE_KEY}/{index}"] = _output_file(part.name, part.sha256, part.bytes)
            path = self.folder / "inputs" / "photos" / photo_name(index, part.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            self.runtime.artifacts.fetch(part.sha256, path)
            self.photos.append(path)

    def take(self, files: Iterable[OutputFile]) -> None:
        """Fetch files for the following stages."""
        for file in files:
            path = self.files[file.name] = self.folder / "inputs" / file.name
            self.runtime.artifacts.fetch(file.sha256, path)
            self.hashes[file.name] = file.sha256
            self.sources[file.name] = file

    def outputs_of(self, stage: JobType) -> tuple[OutputFile, ...]:
        """Return the files of a stage: those of an earlier attempt, cached ones, or new ones."""
        if any(other.name == stage and other.state == "succeeded" for other in self.job.stages):
            published = [file for file in self.runtime.store.artifacts_of(self.job.id) if file.stage == stage]
            return tuple(
                OutputFile(name=a.name, media_type=a.media_type, sha256=a.sha256, bytes=a.bytes, facts=a.facts)
                for a in published
            )
        store, retention_s = self.runtime.store, self.runtime.settings.artifact_retention_s
        key = stage_key(self.job, stage, self.hashes)
        cached = find_stored(store, self.runtime.artifacts, key)
        start_stage(store, self.watch.claimed, stage)
        files = self._run(stage) if cached is None else cached
        reused = cached is not None
        publish_stage(store, self.watch.claimed, stage, files, key=key, cached=reused, retention_s=retention_s)
        logger.info("stage %s of job %s published", stage, self.job.id, extra={"cached": reused})
        return files

    def deliver(self, destination: str) -> None:
        """Copy all artifacts of the job to a URL in a bucket.

        Raises:
            StorageAwayError: the bucket does not accept them.
        """
        settings = self.runtime.settings
        bucket = open_objects(destination, patience_s=settings.patience_s, credentials=settings.s3_credentials)
        for artifact in self.runtime.store.artifacts_of(self.job.id):
            self.watch.check()
            with reporting_refusals():
                obstore.put(bucket, artifact.name, self.files[artifact.name])

    def _run(self, stage: JobType) -> tuple[OutputFile, ...]:
        """Run a stage; files that it wrote before a failure are published too, since they may explain it."""
        from worker.stages import STAGES, StageInput

        own = self.folder / stage
        own.mkdir()
        given = StageInput(
            job=self.job,
            folder=own,
            resume_dir=half_done_folder(self.runtime.settings, self.job),
            files=self.files,
            source_sha256="" if self.asset.kind == "photos" else self.asset.parts[0].sha256,
            photos=tuple(self.photos),
            report=partial(self.watch.report, stage),
            recall=partial(self.recall, stage, own),
            publish=lambda path: self._offer(stage, self._stored(path)),
        )
        try:
            return tuple(self._stored(path, given.facts.get(path.name)) for path in STAGES[stage](given))
        except Cancelled:
            raise
        except DynamicTreeError:
            left = sorted(path for path in own.iterdir() if path.is_file() and path.name[0] != ".")
            self._offer(stage, *(self._stored(path, given.facts.get(path.name)) for path in left))
            raise

    def _offer(self, stage: JobType, *files: OutputFile) -> None:
        """Publish files of a stage that is running or has failed."""
        retention_s = self.runtime.settings.artifact_retention_s
        publish(self.runtime.store, self.watch.claimed, stage, files, retention_s=retention_s)

    def recall(self, stage: JobType, folder: Path, name: str, make: Callable[[Path], None]) -> Path:
        """Return the file of a result that does not depend on the formats, from an earlier job or newly computed."""
        path = folder / f".{name}"
        learned = name == "reconstruction"
        if learned:
            used = [file for source, file in self.sources.items() if source.startswith(SOURCE_KEY)]
        else:
            used = [self.sources[source] for source in RESULT_SOURCES[name]]
        choice = (LearningParams if learned else CloudParams).part_of(self.job.params).model_dump(mode="json")
        key = result_key(name, self.job, [file.sha256 for file in used], choice)
        alone: AbstractContextManager[None] = nullcontext()
        if learned and not find_stored(self.runtime.store, self.runtime.artifacts, key):
            working_on = half_done_folder(self.runtime.settings, self.job)
            alone = locked_folder(working_on, partial(self.watch.report, stage, 0.0))
        with alone:  # one job at a time learns a scene; those that waited reuse its result
            file = self._remembered(key, path)
            if file is None:
                make(path)
                file = replace(self._stored(path), name=name, media_type=MEDIA_TYPE)
            remember_intermediate(self.runtime.store, key, name, file, used, owner=self.job.owner)
        return path

    def _remembered(self, key: str, path: Path) -> OutputFile | None:
        """Fetch an earlier job's result to a path; return None if there is none."""
        files = find_stored(self.runtime.store, self.runtime.artifacts, key)
        if files:
            self.runtime.artifacts.fetch(files[0].sha256, path)
        return files[0] if files else None

    def _stored(self, path: Path, facts: Facts | None = None) -> OutputFile:
        """Store a file's bytes."""
        from dynamictree.export.table import media_type  # imported with the stages, not at the start

        digest, size = hash_file(path)
        touch_blob(self.runtime.store, digest, size)
        self.runtime.artifacts.put(path, digest)
        return OutputFile(
            name=path.name, media_type=media_type(path.name), sha256=digest, bytes=size, facts=facts or {}
        )


def _output_file(name: str, digest: str, size: int) -> OutputFile:
    return OutputFile(name=name, media_type=MEDIA_TYPE, sha256=digest, bytes=size)
