"""File name endings and limits by which uploads are classified before they are opened."""

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off", ".3mf", ".dae")
POINT_SUFFIXES = (".xyz", ".txt", ".csv", ".asc", ".pts")
CLOUD_SUFFIXES = (".ply", ".splat", ".spz", ".sog", ".ksplat", ".glb", ".las", ".laz", ".pcd", *POINT_SUFFIXES)
SOG_FOLDER_FILE = "meta.json"  # of a splat in a folder of pictures
MASK_NAME = "mask.npy"  # of a cloud: one bool a Gaussian

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif")
FILM_SUFFIXES = (".mp4", ".mov", ".m4v")  # of phones and cameras: one container; uploads may have no other
OTHER_FILM_SUFFIXES = (".webm", ".mkv", ".avi")
MASKS = "masks"  # folder of the masks of photos
