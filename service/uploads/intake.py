"""Turn received files into an asset: find the model among them, parse it, store it."""

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from fastapi.concurrency import contextmanager_in_threadpool
from starlette.concurrency import run_in_threadpool

from dynamictree.formats.companions import is_system_file
from dynamictree.formats.film import MAX_FILM_BYTES
from dynamictree.formats.suffixes import (
    CLOUD_SUFFIXES,
    FILM_SUFFIXES,
    MASKS,
    MESH_SUFFIXES,
    PHOTO_SUFFIXES,
    POINT_SUFFIXES,
    SOG_FOLDER_FILE,
)
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS
from dynamictree.requests import Reading
from jobs.lifecycle.attempts import touch_blob
from jobs.records import AssetPart, AssetRecord, Json
from jobs.states import AssetKind
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import add_asset, find_asset
from jobs.storage.parser_process import ParseRequest, parse
from jobs.storage.stage_files import CLOUD_BUNDLE, MESH_BUNDLE
from jobs.store import new_id
from service.http.multipart import ReceivedFile
from service.http.problems import ProblemError
from service.schemas.assets import AssetOptions
from service.services import Owned
from service.uploads.archives import is_zip, unpack
from service.uploads.exif_privacy import without_location
from service.uploads.quota import require_room

CAMERA_FILES = (
    *("transforms.json", "poses_bounds.npy"),
    *(f"{name}.{end}" for name in ("cameras", "images", "points3D", "rigs", "frames") for end in ("txt", "bin")),
)
"""Files that may come with photos: known cameras."""
MAX_PHOTO_BYTES = 30 * 1024**2


@dataclass(frozen=True, kw_only=True)
class Upload:
    """Files of one asset, the models first, and how to read them."""

    kind: AssetKind  # the content decides whether a model is a mesh or a cloud
    num_models: int = 1
    files: tuple[ReceivedFile, ...]
    reading: Reading = field(default_factory=Reading)
    unused: tuple[str, ...] = ()  # names of files that came with photos and are not stored
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_film(self) -> bool:
        """Return whether the photos are to be chosen from a film."""
        return self.kind == "photos" and _suffix(self.files[0]) in FILM_SUFFIXES

    @property
    def fingerprint(self) -> str:
        """sha256 of everything that determines the asset; names count, because files refer to one another by name."""
        meaning = [
            self.kind,
            self.reading.up_axis,
            self.reading.unit_m,
            self.reading.height_m,
            [[_beside(file.name), file.sha256] for file in self.files],
        ]
        return sha256(json.dumps(meaning).encode()).hexdigest()


def _classify(owned: Owned, options: AssetOptions, files: list[ReceivedFile], folder: Path) -> Upload:
    """Separate models, companions and photos; unpack a zip if there is room for its content."""
    metadata = options.metadata or {}
    if len(files) == 1 and is_zip(files[0].path) and _suffix(files[0]) not in (".sog", ".3mf"):
        files = unpack(files[0], folder, require_room=partial(require_room, owned))
    files = [file for file in files if not is_system_file(file.name)] or files
    if not files:
        raise ProblemError("validation-failed", "the form has no file; send at least one part with a filename")
    with_photos = [file for file in files if _suffix(file) in PHOTO_SUFFIXES or _is_camera_file(file)]
    pictures = [file for file in with_photos if not _is_camera_file(file)]
    films = [file for file in files if _suffix(file) in FILM_SUFFIXES]
    of_photos = films or (pictures and len(with_photos) == len(files))
    kind = options.kind or ("photos" if of_photos else "mesh")
    if kind == "photos":
        stems = {PurePosixPath(_beside(file.name)).with_suffix("") for file in pictures}
        live = [file for file in films if PurePosixPath(_beside(file.name)).with_suffix("") in stems]
        if films and len(live) == len(films):  # each film belongs to a Live Photo
            stills = [file for file in files if file not in live]
            unused = tuple(file.name for file in live)
            return Upload(kind="photos", files=_photos(stills), unused=unused, metadata=metadata)
        return Upload(kind="photos", files=_film(files) if films else _photos(files), metadata=metadata)
    models = _models(files)
    every = (*models, *(file for file in files if file not in models))
    reading = Reading.part_of(options.model_dump())
    return Upload(kind="mesh", num_models=len(models), files=every, reading=reading, metadata=metadata)


def _film(files: list[ReceivedFile]) -> tuple[ReceivedFile]:
    if len(files) > 1:
        reason = f"there are {len(files)} files with a film among them; send the film of one walk by itself, or photos"
        raise ProblemError("invalid-input", reason)
    [film] = files
    if film.bytes > MAX_FILM_BYTES:
        reason = f"the film {film.name!r} has {film.bytes:,} bytes; at most {MAX_FILM_BYTES:,} are allowed; cut it"
        raise ProblemError("payload-too-large", reason)
    return (film,)


def _photos(files: list[ReceivedFile]) -> tuple[ReceivedFile, ...]:
    no_masks = [file for file in files if PurePosixPath(_beside(file.name)).parent.name != MASKS]
    photos = [file for file in no_masks if not _is_camera_file(file)]
    if not MIN_PHOTOS <= len(photos) <= MAX_PHOTOS:
        raise ProblemError("invalid-input", f"there are {len(photos)} photos; {MIN_PHOTOS} to {MAX_PHOTOS} are allowed")
    different = len({file.sha256 for file in photos})
    if different < MIN_PHOTOS:
        reason = f"there are {len(photos)} photos and {different} of them differ; at least {MIN_PHOTOS} must"
        raise ProblemError("invalid-input", f"{reason}; walk around the tree and take one every 10 to 20 degrees")
    for file in files:
        if _is_camera_file(file):
            continue
        if _suffix(file) not in PHOTO_SUFFIXES:
            raise _unsupported(file, PHOTO_SUFFIXES)
        if file.bytes > MAX_PHOTO_BYTES:
            reason = f"photo {file.name!r} has {file.bytes:,} bytes; at most {MAX_PHOTO_BYTES:,} are allowed"
            raise ProblemError("payload-too-large", reason)
    return tuple(without_location(file) for file in files)


def _models(files: list[ReceivedFile]) -> tuple[ReceivedFile, ...]:
    """Return the models: a mesh, a cloud, or a cloud and a mesh."""
    if len(files) == 1:
        return (files[0],)  # any name is allowed: the content decides
    certain = [file for file in files if _suffix(file) in {*MESH_SUFFIXES, *CLOUD_SUFFIXES} - {*POINT_SUFFIXES}]
    certain = certain or [file for file in files if PurePosixPath(file.name).name == SOG_FOLDER_FILE]
    points = [file for file in files if _suffix(file) in POINT_SUFFIXES]
    models = certain or points  # a text file beside a model is a note or a licence
    if certain and points and all(_suffix(file) != ".txt" for file in points):
        models = certain + points
    if not models:
        suffixes = dict.fromkeys((*MESH_SUFFIXES, *CLOUD_SUFFIXES, *PHOTO_SUFFIXES, *FILM_SUFFIXES))
        raise _unsupported(files[0], tuple(suffixes))
    if len(models) > 2:
        reason = ", ".join(repr(file.name) for file in models[:5])
        detail = (
            f"there are {len(models)} meshes or clouds ({reason}); send one, or a cloud and a mesh in the same place"
        )
        raise ProblemError("invalid-input", detail)
    return tuple(models)


def scratch_folder(owned: Owned) -> AbstractAsyncContextManager[Path]:
    """Context manager that yields a temporary folder for the files of an asset."""

    @contextmanager
    def opened() -> Iterator[Path]:
        with TemporaryDirectory(prefix="asset-", dir=owned.services.settings.scratch_dir) as folder:
            yield Path(folder)

    return contextmanager_in_threadpool(opened())


async def parse_and_store(
    owned: Owned, options: AssetOptions, files: list[ReceivedFile], folder: Path
) -> tuple[AssetRecord, bool]:
    """Parse files in the parser's process, store them and their asset; the second value is whether it is new."""
    store, upload = owned.store, await run_in_threadpool(_classify, owned, options, files, folder)
    expires_at = store.clock() + owned.services.settings.asset_retention_s
    existing = await run_in_threadpool(find_asset, store, upload.fingerprint)
    if existing is not None:
        return await run_in_threadpool(
            add_asset, store, replace(existing, expires_at=expires_at, metadata=upload.metadata)
        )
    prepared = folder / "prepared"
    request = ParseRequest(
        kind=upload.kind,
        num_models=upload.num_models,
        names=tuple(_beside(file.name) for file in upload.files),
        paths=tuple(file.path for file in upload.files),
        prepared=prepared,
        reading=upload.reading.model_dump(),
        memory_bytes=owned.services.settings.parser_memory_bytes,
        cpu_s=owned.services.settings.parser_cpu_s,
    )
    async with owned.services.parsers.slot(owned.store.owner or ""):
        answer = await parse(request, owned.services.settings)
    if answer.summary is None:
        raise ProblemError(answer.code or "invalid-input", answer.message)
    upload = replace(upload, kind=answer.kind or upload.kind)
    summary = dict(answer.summary)
    if upload.unused:
        unused = f"{len(upload.unused)} films of Live Photos were not used, {upload.unused[0]} first"
        warning: dict[str, str | int | float] = {"code": "films-unused", "message": f"{unused}: the photos suffice"}
        summary["warnings"] = [warning]
    return await run_in_threadpool(_store_asset, owned, upload, prepared, summary, expires_at)


def _store_asset(
    owned: Owned, upload: Upload, prepared: Path, summary: Mapping[str, Json], expires_at: float
) -> tuple[AssetRecord, bool]:
    files = (_video_only(upload.files[0], prepared),) if upload.is_film else upload.files
    parts = tuple(AssetPart(name=_beside(file.name), sha256=file.sha256, bytes=file.bytes) for file in files)
    located = [(file.path, part) for file, part in zip(files, parts, strict=True)]
    bundle = None
    if upload.kind != "photos":
        digest, size = hash_file(prepared)
        name = MESH_BUNDLE if upload.kind == "mesh" else CLOUD_BUNDLE
        bundle = AssetPart(name=name, sha256=digest, bytes=size)
        located.append((prepared, bundle))
    for path, part in located:
        touch_blob(owned.store, part.sha256, part.bytes)
        owned.services.artifacts.put(path, part.sha256)
    return add_asset(
        owned.store,
        AssetRecord(
            id=new_id(),
            kind=upload.kind,
            fingerprint=replace(upload, kind="photos" if upload.kind == "photos" else "mesh").fingerprint,
            parts=parts,
            prepared=bundle,
            summary=summary,
            metadata=upload.metadata,
            created_at=owned.store.clock(),
            expires_at=expires_at,
        ),
    )


def _video_only(film: ReceivedFile, prepared: Path) -> ReceivedFile:
    """Return the film as it is stored: an MP4 without sound, location and device names."""
    digest, size = hash_file(prepared)
    name = PurePosixPath(_beside(film.name)).with_suffix(".mp4").name
    return ReceivedFile(name=name, path=prepared, sha256=digest, bytes=size)


def _beside(name: str) -> str:
    """Return the name by which other files refer to this one: relative, with forward slashes."""
    return str(PurePosixPath(name.replace("\\", "/")))


def _is_camera_file(file: ReceivedFile) -> bool:
    return PurePosixPath(_beside(file.name)).name in CAMERA_FILES


def _suffix(file: ReceivedFile) -> str:
    return PurePosixPath(file.name).suffix.lower()


def _unsupported(file: ReceivedFile, suffixes: tuple[str, ...]) -> ProblemError:
    accepted = ", ".join(suffix.lstrip(".") for suffix in suffixes)
    return ProblemError(
        "unsupported-format", f"{file.name!r} is of no format that is accepted; send {accepted}, or a zip"
    )
