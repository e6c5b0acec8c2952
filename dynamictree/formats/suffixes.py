"""File names and endings by which uploads are classified before they are opened."""

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off", ".3mf", ".dae")
POINT_SUFFIXES = (".xyz", ".txt", ".csv", ".asc", ".pts")
CLOUD_SUFFIXES = (".ply", ".splat", ".spz", ".sog", ".ksplat", ".glb", ".las", ".laz", ".pcd", *POINT_SUFFIXES)
SOG_FOLDER_FILE = "meta.json"  # index of a splat stored as a folder of images
MASK_NAME = "mask.npy"  # mask of a cloud: one bool per Gaussian

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif")
FILM_SUFFIXES = (".mp4", ".mov", ".m4v")  # container of phones and cameras; uploads accept no other
OTHER_FILM_SUFFIXES = (".webm", ".mkv", ".avi")
MASKS = "masks"  # folder of the masks of photos
