"""Read everything that comes from outside: camera files, and photos, which are written anew."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dynamictree.reconstruct.input_cameras import InputCamera, find_input_cameras, fits
from dynamictree.reconstruct.photos import Photo, PhotoFile, prepare_photos, sizes_of

Given = tuple[InputCamera, ...] | None
OnPhoto = Callable[[int, int], None]
ReadPhotos = Callable[[Sequence[PhotoFile], Path | None, Path, OnPhoto], tuple[Given, list[Photo]]]


def read_photos(
    photos: Sequence[PhotoFile], root: Path | None, folder: Path, on_photo: OnPhoto
) -> tuple[Given, list[Photo]]:
    """Return the cameras that came with the photos, if any, and the photos that `prepare_photos` wrote to `folder`.

    Raises:
        InputError: as `find_input_cameras` and `prepare_photos`.
    """
    given = None if root is None else _given(photos, root)
    if given is not None:
        by_photo = {camera.photo: camera for camera in given}
        photos = [_as_given(photo, by_photo[photo.name]) for photo in photos if photo.name in by_photo]
    return given, prepare_photos(photos, folder, on_photo=on_photo)


def _given(photos: Sequence[PhotoFile], root: Path) -> Given:
    return find_input_cameras(
        root, {photo.name: sizes_of(photo) for photo in sorted(photos, key=lambda photo: photo.name)}
    )


def _as_given(photo: PhotoFile, camera: InputCamera) -> PhotoFile:
    """Turn a photo upright only if the given camera saw it so: some programs heed EXIF and some do not."""
    stored, _ = sizes_of(photo)
    return replace(photo, as_stored=fits(camera, stored))
